"""What README and docs name exists."""

import importlib.util
import pkgutil
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
README = (ROOT / "README.md").read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text())
    local = [link for link in links if "://" not in link]
    assert [link for link in local if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_exists(page):
    text = page.read_text()
    modules = set(re.findall(r"python -m ((?:unet_)?fem[\w.]*)", text))
    assert [name for name in modules if not importlib.util.find_spec(name)] == []
    files = set(re.findall(r"\b((?:tools|configs|tests|docs)/[\w./-]+\.\w+)", text))
    assert [name for name in files if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_and_name_in_backticks_exists(page):
    """`fem.solver.energy`, `unet_fem.runtime.Surrogate`, `fem.equilibrium(mesh, ...)`."""
    if page.name == "CHANGELOG.md":  # it names old paths
        return
    for path in set(re.findall(r"`((?:unet_)?fem(?:\.\w+)+)\b", page.read_text())):
        assert pkgutil.resolve_name(path) is not None


def test_readme_stays_short():
    assert len(README.splitlines()) < 200


def test_every_tool_is_explained_somewhere():
    told = "".join(page.read_text() for page in PAGES)
    tools = [path for path in (ROOT / "tools").glob("*.py") if "__main__" in path.read_text()]
    assert [path.name for path in tools if f"python tools/{path.name}" not in told] == []
