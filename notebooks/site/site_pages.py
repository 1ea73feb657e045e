"""The pages of the site, made of what says the same elsewhere: README, docstrings, help, schema, notebooks.

MkDocs calls `on_files`; `pages` needs no MkDocs.
"""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {  # pages by the sections of README on them
    "index.md": ["What you can do with it"],
    "accuracy.md": ["How right, how fast"],
    "scene.md": ["A scene"],
    "method.md": ["The method"],
    "laws.md": ["Laws, and how to add one"],
    "calibration.md": ["Calibration"],
    "gradients.md": ["Gradients"],
    "code.md": ["Map of the code"],
}


def on_files(files, config):
    """Add the pages to those on disk."""
    from mkdocs.structure.files import File

    for uri, content in pages().items():
        about = {"content": content} if isinstance(content, str) else {"abs_src_path": str(content)}
        files.append(File.generated(config, uri, **about))
    return files


def pages() -> dict[str, str | Path]:
    """Every page that is made, its Markdown by its address; a picture is the path of its file."""
    made = readme() | {"api.md": api(), "commands.md": commands(), "keys.md": keys()}
    made |= {f"{path.stem}.md": notebook(path) for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
    for text in [*made.values()]:
        for name in re.findall(r"\]\(pictures/([^)]+)\)", text):
            made[f"pictures/{name}"] = next(ROOT / folder / name for folder in ("jaxmpm/scenes", "notebooks") if (ROOT / folder / name).exists())
    return made


def readme() -> dict[str, str]:
    """README in pages, a chapter each; its links and pictures as they are here."""
    head, *chapters = re.split(r"^## (.*)\n", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    chapters = dict(zip(chapters[::2], chapters[1::2], strict=True))
    made = {page: "\n".join(f"# {name}\n{chapters[name]}" for name in names) for page, names in SECTIONS.items()}
    made["index.md"] = head + made["index.md"].replace("# ", "## ", 1)
    made = {page: re.sub(r"^#(#+ )", r"\1", text, flags=re.MULTILINE) if page != "index.md" else text for page, text in made.items()}
    where = {_anchor(title): page for page, text in made.items() for title in re.findall(r"^#+ (.*)", _without_code(text), re.MULTILINE)}
    for page, text in made.items():
        text = re.sub(r"\]\(#([\w-]+)\)", lambda link: f"]({where[link[1]]}#{link[1]})", text)
        made[page] = re.sub(r"\]\((?:jaxmpm/scenes|notebooks)/([\w.]+\.png)\)", r"](pictures/\1)", text)
    return made


def _anchor(title: str) -> str:
    return re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-")


def _without_code(text: str) -> str:
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def api() -> str:
    """The public names, whose docstrings the site's plugin puts in."""
    import jaxmpm

    text = f"# From Python\n\n```python\n{_indented(jaxmpm.__doc__)}```\n\nUnits everywhere: mm, N, MPa, s, tonne; tension is positive.\n"
    return text + "".join(f"\n::: {module}.{name}\n" for name, module in jaxmpm._PUBLIC.items())


def _indented(text: str) -> str:
    return "".join(line.removeprefix("    ") + "\n" for line in text.splitlines() if line.startswith("    "))


def commands() -> str:
    """The help of every command."""
    from calibration.cli import make_parser as calibrate
    from jaxmpm.cli import make_parser

    text = "# Commands\n"
    for top in (make_parser(), calibrate()):
        (below,) = [action for action in top._actions if action.metavar in ("COMMAND", "WHAT")]
        for parser in (top, *(one for name, one in below.choices.items() if name != "calibrate")):
            text += f"\n## {parser.prog}\n\n```text\n{parser.format_help()}```\n"
    return text


def keys() -> str:
    """Every table of a scene and its keys."""
    from jaxmpm.scene import Scene

    schema = Scene.model_json_schema()
    text = "# Keys of a scene\n"
    for name, table in {"Scene": schema, **schema["$defs"]}.items():
        name = name.rpartition("__")[2]
        text += f"\n## {name}\n\n{table.get('description', '')}\n\n| key | meaning | if left out |\n|---|---|---|\n"
        for key, node in table["properties"].items():
            given = node.get("default")
            given = "–" if isinstance(given, dict) or given in (None, []) else f"`{json.dumps(given, ensure_ascii=False)}`"
            text += f"| `{key}` | {_meaning(node)} | {'required' if key in table.get('required', ()) else given} |\n"
    return text


def _meaning(node: dict) -> str:
    """What a key is, with its choices."""
    choices = node.get("enum") or [option["const"] for option in [node, *node.get("anyOf", ())] if "const" in option]
    words = [node.get("description", "")] + [", ".join(f'`"{choice}"`' for choice in choices)]
    tables = re.findall(r"#/\$defs/(\w+)", json.dumps(node))
    links = [f"[{name}](#{name.lower()})" for name in dict.fromkeys(one.rpartition("__")[2] for one in tables)]
    return "; ".join(part.replace("|", "\\|") for part in (*words, " or ".join(links)) if part)


def notebook(path: Path) -> str:
    """A notebook as it was saved, its cells and what they showed."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        parts += [_output(output) for output in cell.get("outputs", ())]
    text = re.sub(r"\]\(([\w.]+\.png)\)", r"](pictures/\1)", "\n\n".join(parts))
    return re.sub(r"\]\(([\w.]+)\.ipynb\)", r"](\1.md)", text) + "\n"


def _output(output: dict) -> str:
    data = output.get("data", {})
    if "image/png" in data:
        return f'<img alt="" src="data:image/png;base64,{"".join(data["image/png"]).strip()}">'.replace("\n", "")
    if "text/html" in data:
        return "".join(data["text/html"])
    return "```text\n" + "".join(output.get("text") or data.get("text/plain", "")).rstrip() + "\n```"
