"""The documentation holds what it says: its code runs, the docstrings' examples give what they show, its links lead somewhere."""

import doctest
import importlib
import importlib.util
import inspect
import pkgutil
import re
import shlex
import sys
from html.parser import HTMLParser
from pathlib import Path

import beltrami as bt
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MODULES = [found.name for found in pkgutil.walk_packages(bt.__path__, "beltrami.") if not found.name.endswith(("._core", ".__main__"))]


def blocks(text: str, language: str) -> list[tuple[int, str]]:
    """Line and code of each block in a language."""
    return [(text.count("\n", 0, found.start(1)) + 1, found[1]) for found in re.finditer(rf"^```{language}\n(.*?)^```$", text, re.M | re.S)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_of_pages_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    threads = bt.num_threads()
    namespace: dict[str, object] = {"__name__": page.stem}
    try:
        for line, code in blocks(page.read_text(encoding="utf-8"), "python"):
            exec(compile("\n" * (line - 1) + code, str(page), "exec"), namespace)  # lines of errors are those of the page
    finally:
        bt.set_num_threads(threads)


def test_commands_of_pages_are_understood() -> None:
    """Each line of a shell that calls beltrami has a command and options that there are."""
    from beltrami.__main__ import parser

    lines = [line for page in PAGES for _, code in blocks(page.read_text(encoding="utf-8"), "sh") for line in code.splitlines()]
    lines += [line for page in PAGES for line in re.findall(r"`(beltrami [a-z-]+ [^`]+)`", page.read_text(encoding="utf-8"))]
    calls = [line for line in lines if line.startswith("beltrami ") and "COMMAND" not in line]
    assert len(calls) > 20
    for line in calls:
        parser().parse_args(shlex.split(line, comments=True)[1:])  # it leaves with 2 where an option is unknown


def test_pages_of_methods_follow_one_pattern() -> None:
    """A picture or a table, a runnable example, what it costs or where it ends, and where to go on."""
    groups = {"README", "index", "installation", "command_line", "conventions", "contributing", "benchmarks", "rust", "coming_from"}
    for page in (page for page in PAGES if page.stem not in groups):
        text = page.read_text(encoding="utf-8")
        assert blocks(text, "python"), page.stem
        assert re.search(r"^(#+ |\*\*)(Limits|Cost and limits|What is refused)", text, re.M), f"{page.stem} does not say where it ends"
        assert re.search(r"Cost\b", text), f"{page.stem} does not say what it costs"
        assert re.search(r"[Cc]ertificate|What is certain|How far to trust it", text), f"{page.stem} certifies nothing"
        assert "\nSee also: [" in text, f"{page.stem} leads nowhere"


def test_blocks_are_found_and_fail() -> None:
    assert blocks("a\n```python\n1 / 0\n```\nb\n```sh\nls\n```\n", "python") == [(3, "1 / 0\n")]
    assert len(blocks((ROOT / "README.md").read_text(encoding="utf-8"), "python")) >= 1


def test_rust_of_the_readme_is_the_example() -> None:
    """`cargo test` builds the example, so that no page can go stale."""
    example = (ROOT / "examples" / "first_steps.rs").read_text(encoding="utf-8")
    body = "\n".join(line.removeprefix("    ") for line in example.splitlines())
    for page in (ROOT / "README.md", ROOT / "docs" / "rust.md"):
        [(_, code)] = blocks(page.read_text(encoding="utf-8"), "rust")
        for line in code.strip().splitlines():
            assert line.strip() in body, f"{line!r} of {page.name} is not in examples/first_steps.rs"


@pytest.mark.parametrize("module", MODULES)
def test_examples_of_docstrings(module: str) -> None:
    outcome = doctest.testmod(importlib.import_module(module))
    assert outcome.failed == 0


def test_public_functions_have_runnable_examples() -> None:
    public = [getattr(bt, name) for name in bt.__all__]
    functions = [item for item in public if inspect.isfunction(item) and item.__module__.startswith("beltrami")]
    without = [item.__name__ for item in functions if ">>>" not in (item.__doc__ or "")]
    assert len(functions) > 10
    assert without == []


class Links(HTMLParser):
    """Anchors of a page, and what it links to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if given.get("id"):
            self.anchors.add(str(given["id"]))
        link = given.get("src") if tag in ("img", "script") else given.get("href")
        if link:
            self.links.append(link)


def dead_links(files: list[Path]) -> list[str]:
    """Links within a folder of pages that lead nowhere, and links to scripts, styles or pictures of the network."""
    pages = {file: Links(file.read_text(encoding="utf-8")) for file in files}
    dead = []
    for file, page in pages.items():
        for link in page.links:
            if re.match(r"[a-z]+:", link):
                continue
            name, _, anchor = link.partition("#")
            target = (file.parent / name).resolve() if name else file
            if not target.is_file() or (anchor and target in pages and anchor not in pages[target].anchors):
                dead.append(f"{file.name}: {link}")
    return dead


def test_site_builds_without_dead_links(tmp_path: Path) -> None:
    pytest.importorskip("markdown", reason="pip install 'beltrami[docs]'")
    spec = importlib.util.spec_from_file_location("docs_build", ROOT / "docs" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    build = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = build
    spec.loader.exec_module(build)
    written = build.build(tmp_path)
    stems = {file.stem for file in written}
    assert {page.stem for page in PAGES[1:]} <= stems
    assert dead_links(written) == []
    text = "".join(file.read_text(encoding="utf-8") for file in written)
    for name in bt.__all__:
        if callable(getattr(bt, name)):
            assert f'id="{name}"' in text, f"{name} is in no page of the reference"
    assert not re.search(r'(?:src|<link[^>]*href)="https?:', text)  # nothing is fetched


def test_dead_links_are_seen(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<h1 id="x"></h1><a href="b.html">b</a><a href="#y">y</a><a href="#x">x</a>', encoding="utf-8")
    assert dead_links([tmp_path / "a.html"]) == ["a.html: b.html", "a.html: #y"]


def test_links_of_the_readme() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#]+)", text):
        assert link.startswith("https:") or (ROOT / link).exists(), link


def test_every_extra_is_explained() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    [block] = re.findall(r"^\[project\.optional-dependencies\]\n(.*?)^\[", project, re.M | re.S)
    extras = re.findall(r"^(\w+) = ", block, re.M)
    page = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8")
    assert len(extras) > 4
    assert [extra for extra in extras if f"`{extra}`" not in page] == []
    code = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "python" / "beltrami").rglob("*.py"))
    assert set(re.findall(r"beltrami\[(\w+)\]", code)) <= set(extras)


def test_the_version_is_the_same_everywhere() -> None:
    wanted = {
        "Cargo.toml": f'version = "{bt.__version__}"',
        "pyproject.toml": f'version = "{bt.__version__}"',
        "python/binding/Cargo.toml": f'version = "{bt.__version__}"',
        "CITATION.cff": f"version: {bt.__version__}",
        "CHANGELOG.md": f"## {bt.__version__}",
    }
    assert [name for name, line in wanted.items() if line not in (ROOT / name).read_text(encoding="utf-8").splitlines()] == []
