"""The site: what its pages are made of, and that it can be built."""

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import jaxmpm
from jaxmpm.cli import main, make_parser
from jaxmpm.layout import lay_out
from jaxmpm.new_scene import kinds
from jaxmpm.scene import Scene, load_scene

SITE = Path(__file__).parents[1] / "notebooks" / "site"
FIRST = (SITE / "pages" / "first.md").read_text()


@pytest.fixture(scope="module")
def pages():
    spec = importlib.util.spec_from_file_location("site_pages", SITE / "site_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.pages() | {path.name: path.read_text() for path in (SITE / "pages").glob("*.md")}


def test_every_page_is_named_once_and_is_there(pages):
    named = re.findall(r": (\S+\.md)$", (SITE / "mkdocs.yml").read_text(), re.MULTILINE)
    assert sorted(named) == sorted(page for page in pages if page.endswith(".md"))
    assert all(path.is_file() for path in pages.values() if isinstance(path, Path))
    assert all(re.search(r"^#+ \S", text, re.MULTILINE) for text in pages.values() if isinstance(text, str))


def test_nothing_of_readme_is_lost_and_links_lead_somewhere(pages):
    readme = (SITE.parents[1] / "README.md").read_text()
    for title in re.findall(r"^##+ (.*)", re.sub(r"```.*?```", "", readme, flags=re.DOTALL), re.MULTILINE):
        assert sum(f"# {title}\n" in text for text in pages.values() if isinstance(text, str)) >= 1, title
    for page, text in pages.items():
        for link in re.findall(r"\]\(([^)#\s]+)(?:#[\w-]+)?\)", re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL) if isinstance(text, str) else ""):
            assert link.startswith("https://") or link in pages, (page, link)


def test_reference_pages_know_all_there_is(pages):
    assert all(f".{name}\n" in pages["api.md"] for name in jaxmpm.__all__)
    commands = next(action for action in make_parser()._actions if action.metavar == "COMMAND").choices
    assert all(f"## jaxmpm {name}\n" in pages["commands.md"] for name in commands)
    schema = Scene.model_json_schema()
    for name, table in schema["$defs"].items():
        part = pages["keys.md"].split(f"\n## {name.rpartition('__')[2]}\n")[1:]
        assert any(all(f"| `{key}` |" in one.split("\n## ")[0] for key in table["properties"]) for one in part), name


def test_the_first_scene_can_be_followed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for line in "".join(re.findall(r"```sh\n(.*?)```", FIRST, re.DOTALL)).splitlines():
        make_parser().parse_all(shlex.split(line)[1:])
    assert main(["new", "my.toml"]) == 0
    text = kinds()["plate"].read_text()
    (minus,) = re.findall(r"```toml\n(.*?)```", FIRST, re.DOTALL)
    Path("holed.toml").write_text(re.sub(r"^minus = .*\n", minus, text, flags=re.MULTILINE))
    whole, holed, longer = (lay_out(load_scene(*one)) for one in (("my.toml",), ("holed.toml",), ("my.toml", ["parameters.notch=120"])))
    missing = [int((one.material < 0).sum()) for one in (whole, holed, longer)]
    assert missing[0] == 16 * 2 and missing[1] == pytest.approx(32 + 28, abs=4) and missing[2] == 24 * 2
    capsys.readouterr()
    assert main(["run", "my.toml", "--set", "grid.cel=2.5"]) == 2
    assert capsys.readouterr().err in FIRST


def test_the_site_is_built_and_no_link_in_it_is_broken(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-f", str(SITE / "mkdocs.yml"), "-d", str(tmp_path)]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    reference = (tmp_path / "api" / "index.html").read_text()
    assert all(f'id="{module}.{name}"' in reference for name, module in jaxmpm._PUBLIC.items())
    assert all((tmp_path / "pictures" / name).stat().st_size for name in ("den.png", "stability.png"))
