"""Phases from a picture with labels, such as a segmented slice of a scan."""

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpm.errors import SceneError, written

KEY = "mesostructure.image"


def find_image(tree: dict[str, Any], folder: Path) -> None:
    """Put in where the image of a scene is, looked for beside it, and a digest of what it holds.

    With its digest in the scene, a run is not resumed with another image unnoticed.
    """
    table = tree.get("mesostructure")
    image = table.get("image") if isinstance(table, dict) else None
    file = image.get("file") if isinstance(image, dict) else None
    if not isinstance(file, str):
        return
    path = folder / file
    digest = _digest(path, file)
    _check_digest(image.get("digest") or digest, digest, file)
    image |= {"file": str(path.resolve()), "digest": digest}


def _digest(path: Path, file: str) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise SceneError(
            f"{KEY}.file = {written(file)}: expected a file beside the scene to read ({error.strerror}: {path})"
        ) from None


def _check_digest(known: str, now: str, file: str) -> None:
    if known != now:
        raise SceneError(
            f"{KEY}.file = {written(file)}: expected the file as it was when this scene was written "
            f"(digest {known}, now {now}; remove the digest)"
        )


def phases(image, names) -> np.ndarray:
    """Index into `names` of the material of each pixel, (rows, columns), the first row at the top.

    `image`: that table of a scene. Raises SceneError for a file that is missing, has changed or is no
    image of whole numbers, and for values without a material.
    """
    digest = _digest(Path(image.file), image.file)
    _check_digest(image.digest or digest, digest, image.file)
    pixels = _read(image.file, digest)
    known = {int(value): names.index(name) for value, name in image.labels.items()}
    values, inverse = np.unique(pixels, return_inverse=True)
    unknown = [int(value) for value in values if int(value) not in known]
    if unknown:
        some = ", ".join(map(str, unknown[:12])) + (" ..." if len(unknown) > 12 else "")
        raise SceneError(
            f"{KEY}.labels = {written(image.labels)}: expected a material for each value of {Path(image.file).name} "
            f"(none for {some}" + ("; an image of so many values is not segmented)" if len(unknown) > 12 else ")")
        )
    return np.array([known[int(value)] for value in values])[inverse.reshape(pixels.shape)]


@lru_cache(maxsize=4)
def _read(file: str, digest: str) -> np.ndarray:
    """Whole numbers (rows, columns) of a PNG or .npy file; of a picture with a palette, its numbers."""
    try:
        pixels = np.load(file, allow_pickle=False) if file.lower().endswith(".npy") else _read_png(file)
    except (OSError, ValueError, EOFError, SyntaxError) as error:
        raise SceneError(f"{KEY}.file = {written(file)}: expected an image that can be read ({error})") from None
    if pixels.ndim != 2 or not pixels.size or pixels.dtype.kind not in "biuf":
        shape = " by ".join(map(str, pixels.shape))
        raise SceneError(f"{KEY}.file = {written(file)}: expected rows and columns of grey values (it is {shape} {pixels.dtype})")
    if pixels.dtype.kind == "f" and not (pixels == np.rint(pixels)).all():
        raise SceneError(f"{KEY}.file = {written(file)}: expected whole numbers as labels")
    return pixels.astype(np.int64)


def _read_png(file: str) -> np.ndarray:
    from PIL import Image

    with Image.open(file) as picture:
        pixels = np.asarray(picture)
    if pixels.ndim == 3:
        colours = pixels[..., :-1] if pixels.shape[2] in (2, 4) else pixels
        if (colours != colours[..., :1]).any():
            raise ValueError("it has colours: save it in grey, or with a palette")
        pixels = colours[..., 0]
    return pixels


def at(pixels: np.ndarray, box, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values (nx, ny) of pixels (rows, columns) stretched over a box, at the places x × y, mm.

    `box`: (x min, y min, x max, y max); `x` (nx,), `y` (ny,). Beyond the box its edge goes on.
    """
    rows, columns = pixels.shape
    column = _number(x, box[0], box[2], columns)
    row = rows - 1 - _number(y, box[1], box[3], rows)
    return pixels[row[None, :], column[:, None]]


def _number(line, low, high, count):
    # A place on the border of two pixels belongs to the upper one, whatever the round-off.
    place = (line - low) / (high - low) * count + 1e-6
    return np.clip(np.floor(place).astype(int), 0, count - 1)
