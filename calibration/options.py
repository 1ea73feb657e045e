"""Numbers on the command line of `jaxmpm calibrate`, each checked as it is read."""

import argparse
import math

from jaxmpm.errors import SceneError


def positive(text: str) -> float:
    """A finite number above zero."""
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text}: expected a finite number above 0")
    return value


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: expected a finite number")
    return value


def width(text: str) -> float | None:
    """A width above zero, or None for "fit"."""
    return None if text == "fit" else positive(text)


def share(text: str) -> float:
    """A number between 0 and 1."""
    value = number(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected a number between 0 and 1")
    return value


def weight(text: str) -> float:
    """A finite number, 0 or more."""
    value = float(text)
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text}: expected a finite number, 0 or more")
    return value


def count(text: str) -> int:
    """A whole number above 0."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected a whole number above 0")
    return value


def named(pairs, option: str, expected: str) -> dict[str, float]:
    """Finite numbers by name of NAME=VALUE; raises SceneError that says what was `expected`."""
    found = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            found[name] = number(text)
        except argparse.ArgumentTypeError:
            raise SceneError(f"{option} {pair}: expected {expected}") from None
    return found
