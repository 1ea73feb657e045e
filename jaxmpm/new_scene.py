"""Begins a scene of one's own: a commented file that runs as it is."""

from pathlib import Path

from jaxmpm import schema
from jaxmpm.errors import SceneError, near_or
from jaxmpm.scene_source import bundled, read

TEMPLATES = Path(__file__).parent / "templates"


def kinds() -> dict[str, Path]:
    """What a scene can begin as, name to file: what is meant to be changed first, then the bundled scenes."""
    return {path.stem: path for path in sorted(TEMPLATES.glob("*.toml"))} | bundled()


def write_scene(path: str | Path, like: str = "plate", with_schema: bool = True) -> list[Path]:
    """Write a scene and what it needs beside it; returns their paths, the scene's first.

    `like`: of `kinds`; `with_schema`: also the schema, named in the scene's first line, by which editors
    complete and check it. Raises SceneError for a name that does not end in .toml, another kind, or a
    file that is there already.
    """
    path, known = Path(path), kinds()
    if like not in known:
        raise SceneError(f"--like = {like}: {near_or(like, known)}")
    if path.suffix != ".toml":
        raise SceneError(f"{path}: expected a name that ends in .toml (did you mean {path.name}.toml?)")
    source = known[like]
    files = {path: (schema.LINE if with_schema else "") + source.read_text(encoding="utf-8")}
    for name in _beside(source):
        files[path.parent / name] = (source.parent / name).read_text(encoding="utf-8")
    for target in files:
        if target.exists():
            raise SceneError(f"{target}: expected a file that is not there yet: nothing is overwritten (choose another name)")
    path.parent.mkdir(parents=True, exist_ok=True)
    for target, text in files.items():
        with open(target, "x", encoding="utf-8") as file:
            file.write(text)
    return [*files, *([schema.write_schema(path.parent)] if with_schema else [])]


def _beside(source: Path) -> list[str]:
    """Names of the files that a scene refers to."""
    reference = read(source).get("response", {}).get("reference")
    return [reference] if isinstance(reference, str) and reference else []
