"""Builds the site: `python docs/build.py [-o site]` makes static pages, which open from disk, of docs/*.md and of the docstrings.

A page is a Markdown file in this folder. ORDER names their order; a page that it does not name comes last among the methods. Nothing is
fetched."""

from __future__ import annotations

import argparse
import dataclasses
import html
import importlib
import inspect
import re
import shutil
from pathlib import Path
from typing import Any

import beltrami as bt
import markdown

HERE = Path(__file__).resolve().parent
ORDER = (
    ("Start", ("index", "installation", "coming_from", "files", "shapes", "point_clouds", "command_line", "pictures", "rust")),
    ("Foundation", ("operators", "solvers", "eigenpairs", "geodesics", "neighbours")),
    (
        "Methods",
        (
            "segmentation",
            "spherical_maps",
            "skeletons",
            "registration",
            "conformal_registration",
            "transport",
            "sliced_wasserstein",
            "committors",
        ),
    ),
    ("Project", ("conventions", "benchmarks", "contributing")),
)
# Modules a user meets beside the names of `beltrami` itself.
MODULES = ("shapes", "examples", "colors", "contours", "clouds", "intrinsic", "sliced", "conformal", "costs", "gallery")
CURRENT = ' aria-current="page"'
Groups = dict[str, list[tuple[str, str]]]  # heading: (file without suffix, title)
INDEX = re.compile(r"(?<!\w)([A-Za-zα-ωΓΣΦΨ∂∫)])_(?:(\w{1,2})\b|\{([^}]+)\})")  # m_i, A_T, L_ij, P_{k+1}
POWER = re.compile(r"(?<=[\w)²|])\^(?:(-?\d+(?:[./]\d+)?|[A-Za-zα-ω]+)|\(([^)]+)\))")  # n^1.2, s^T, λ^(-d/4)
FORMULA = re.compile(r"<pre><code>(.*?)</code></pre>", re.S)  # an indented block; code stands in fences, which have a language
SECTION = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}$", re.M)


# --- pages ----------------------------------------------------------------------------------------------------------------------------


def title_of(text: str, stem: str) -> str:
    """The first headline of a page."""
    found = re.search(r"^# (.+)$", text, re.M)
    return found[1].strip() if found else stem.replace("_", " ").capitalize()


def pages(folder: Path = HERE) -> Groups:
    """Groups of (stem, title), of all Markdown files that are there."""
    there = {path.stem: title_of(path.read_text(encoding="utf-8"), path.stem) for path in sorted(folder.glob("*.md"))}
    there["index"] = "Overview"
    named = {stem for _, stems in ORDER for stem in stems}
    groups = {}
    for group, stems in ORDER:
        chosen = (*stems, *(stem for stem in there if stem not in named)) if group == "Methods" else stems
        groups[group] = [(stem, there[stem]) for stem in chosen if stem in there]
    return {group: items for group, items in groups.items() if items}


def to_html(text: str) -> str:
    """HTML of Markdown; links to pages of the folder become links to their HTML."""
    body = markdown.markdown(text, extensions=["tables", "fenced_code", "toc", "sane_lists"])
    body = re.sub(r'href="(?!https?:)([\w/-]+)\.md(#[^"]*)?"', lambda m: f'href="{m[1]}.html{m[2] or ""}"', body)
    body = FORMULA.sub(lambda found: f'<p class="formula">{"<br>".join(found[1].strip().splitlines())}</p>', body)
    pieces = re.split(r"(<pre>.*?</pre>|<code>.*?</code>|<[^>]+>)", body, flags=re.S)  # every other one is code or a tag
    body = "".join(piece if at % 2 else typeset(piece) for at, piece in enumerate(pieces))
    return body.replace("<table>", '<div class="scroll"><table>').replace("</table>", "</table></div>")


def typeset(text: str) -> str:
    """Indices and powers of formulas that are written as text."""
    text = INDEX.sub(lambda found: f"{found[1]}<sub>{found[2] or found[3]}</sub>", text)
    return POWER.sub(lambda found: f"<sup>{found[1] or found[2]}</sup>", text).replace("&lt;=", "≤").replace("&gt;=", "≥")


def framed(title: str, body: str, here: str, groups: Groups) -> str:
    """A whole page: sidebar and body."""
    side = ['<strong><a href="index.html">beltrami</a></strong>']
    for group, items in groups.items():
        links = "".join(f'<li><a href="{stem}.html"{CURRENT if stem == here else ""}>{html.escape(name)}</a></li>' for stem, name in items)
        side.append(f"<h2>{html.escape(group)}</h2><ul>{links}</ul>")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{html.escape(title)} · beltrami</title><link rel="stylesheet" href="style.css"></head>\n<body><div class="page">'
        f'<nav id="pages" aria-label="Pages">{"".join(side)}</nav>\n<main><a class="menu" href="#pages">All pages</a>{body}'
        f"<footer>beltrami {bt.__version__}, MIT OR Apache-2.0.</footer></main>"
        "</div></body></html>\n"
    )


# --- the reference --------------------------------------------------------------------------------------------------------------------


def inline(text: str, known: dict[str, str]) -> str:
    """A paragraph of a docstring as HTML: ``code``, roles such as :func:`plot`, numbered references, and links."""

    def role(match: re.Match[str]) -> str:
        name = match[1].removeprefix("~").removeprefix("beltrami.")
        link = known.get(name)
        code = f"<code>{name}</code>"
        return f'<a href="{link}">{code}</a>' if link else code

    text = html.escape(text, quote=False)
    text = re.sub(r"``(.+?)``", r"<code>\1</code>", text, flags=re.S)
    text = re.sub(r":\w+:`([^`]+)`", role, text)
    text = re.sub(r"(?<![`\w])`([^`]+)`", r"<code>\1</code>", text)
    return re.sub(r"\[(\d)\]_", r"[\1]", text)


def prose(text: str, known: dict[str, str]) -> str:
    """Paragraphs, numbered steps and examples."""
    parts = []
    for block in re.split(r"\n\s*\n", text.strip("\n")):
        plain = inspect.cleandoc(block)
        if not plain:
            continue
        if plain.startswith(">>>") or block.startswith("    "):
            parts.append(f"<pre><code>{html.escape(plain)}</code></pre>")
        elif plain.startswith(".. ["):
            parts += [f"<p>{inline(entry, known)}</p>" for entry in re.split(r"\n?\.\. (?=\[)", plain) if entry]
        else:
            parts.append(f"<p>{inline(plain, known)}</p>")
    return "".join(parts)


def items(text: str, known: dict[str, str]) -> str:
    """``name : type`` with an indented text below it, as a list."""
    entries: list[tuple[str, list[str]]] = []
    for line in text.strip("\n").splitlines():
        if line and not line[0].isspace():
            entries.append((line, []))
        elif entries:
            entries[-1][1].append(line)
    found = ""
    for head, body in entries:
        what = inline(inspect.cleandoc("\n".join(body)), known)
        found += f"<dt>{html.escape(head.replace('``', ''))}</dt><dd>{what}</dd>"
    return f'<dl class="items">{found}</dl>'


def docstring(item: Any, known: dict[str, str]) -> str:
    """The docstring of an object as HTML."""
    text = inspect.getdoc(item) or ""
    pieces = SECTION.split(text)
    parts = [prose(pieces[0], known)]
    for name, body in zip(pieces[1::2], pieces[2::2], strict=True):
        listed = name in ("Parameters", "Returns", "Raises", "Attributes", "Yields")
        parts.append(f"<h4>{name}</h4>{items(body, known) if listed else prose(body, known)}")
    return f'<div class="doc">{"".join(parts)}</div>'


def signature(name: str, item: Any) -> str:
    """How it is called."""
    try:
        text = str(inspect.signature(item))
    except (TypeError, ValueError):
        return name
    text = re.sub(r" -> '?None'?$", "", text) if inspect.isclass(item) else text
    text = re.sub(r"\b(?:beltrami|numpy|typing|collections\.abc|np|npt)\.(?:\w+\.)*", "", text)
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", text).replace("'", '"')  # annotations are quoted, and so are words as defaults
    return name + text if len(name + text) < 100 else name + re.sub(r", (?=\*|\w+:)", ",\n    ", text)


def summary(item: Any) -> str:
    """The first sentence of a docstring."""
    first = (inspect.getdoc(item) or "").split("\n\n")[0].replace("\n", " ")
    return re.split(r"(?<=[.:]) (?=[A-Z`])", first)[0]


def reference() -> dict[str, dict[str, Any]]:
    """What each page of the reference has: module -> name -> object."""
    found: dict[str, dict[str, Any]] = {}
    for name in bt.__all__:
        item = getattr(bt, name)
        if inspect.ismodule(item) or not (inspect.isclass(item) or callable(item)):
            continue
        module = str(item.__module__).removeprefix("beltrami").strip(".").split(".")[0] or "threads"  # a folder's parts on one page
        found.setdefault({"_core": "threads", "builtins": "threads"}.get(module, module), {})[name] = item
    for module in MODULES:
        try:
            part = importlib.import_module(f"beltrami.{module}")
        except ModuleNotFoundError:
            continue  # a method that is not there yet
        public = getattr(part, "__all__", None) or [name for name, item in vars(part).items() if _own(part, name, item)]
        for name in public:
            item = getattr(part, name)
            if callable(item) and name not in bt.__all__ and hasattr(item, "__name__"):
                found.setdefault(module, {})[name] = item
    return {module: dict(sorted(names.items(), key=lambda pair: inspect.isclass(pair[1]))) for module, names in sorted(found.items())}


def _own(module: Any, name: str, item: Any) -> bool:
    kind = inspect.isclass(item) or inspect.isfunction(item)
    return kind and not name.startswith("_") and item.__module__ == module.__name__ and bool(item.__doc__)


def qualified(module: str, name: str) -> str:
    """The name as a user writes it."""
    return f"bt.{name}" if name in bt.__all__ else f"bt.{module}.{name}" if module in bt.__all__ else f"beltrami.{module}.{name}"


def members(item: type) -> list[tuple[str, Any]]:
    """Public methods and properties with a docstring, of the class and of its bases in beltrami."""
    found: dict[str, Any] = {}
    fields = {field.name for field in dataclasses.fields(item)} if dataclasses.is_dataclass(item) else set()
    for base in item.__mro__:
        if base.__module__.startswith("beltrami"):
            for name, value in vars(base).items():
                function = getattr(value, "func", getattr(value, "fget", getattr(value, "__func__", value)))
                if not name.startswith("_") and name not in fields and name not in found and callable(function) and function.__doc__:
                    found[name] = value
    return list(found.items())


def module_page(module: str, names: dict[str, Any], known: dict[str, str]) -> str:
    """The reference of one module."""
    try:
        about = summary(importlib.import_module(f"beltrami.{module}"))
    except ModuleNotFoundError:
        about = ""
    parts = [f"<h1>{module}</h1>", f"<p>{inline(about, known)}</p>" if about else ""]
    for name, item in names.items():
        parts.append(f'<h2 id="{name}"><code>{qualified(module, name)}</code></h2>')
        if not (inspect.isclass(item) and (issubclass(item, Exception) or inspect.isabstract(item))):
            parts.append(f'<pre class="signature"><code>{html.escape(signature(name, item))}</code></pre>')
        parts.append(docstring(item, known))
        if inspect.isclass(item) and not issubclass(item, Exception):
            for member, value in members(item):
                function = getattr(value, "func", getattr(value, "fget", getattr(value, "__func__", value)))
                call = member if isinstance(value, property) or hasattr(value, "func") else signature(member, function)
                call = call.replace("(self, ", "(").replace("(self)", "()").replace("(cls, ", "(")
                parts.append(f'<h3 id="{name}.{member}"><code>.{html.escape(call)}</code></h3>{docstring(function, known)}')
    return "".join(parts)


# --- the whole ------------------------------------------------------------------------------------------------------------------------


def build(out: Path, rust: Path | None = None) -> list[Path]:
    """Writes the site; the files."""
    groups, found = pages(), reference()
    groups["Reference"] = [("reference", "All names"), *((f"reference_{module}", module) for module in found)]
    known = {name: f"reference_{module}.html#{name}" for module, names in found.items() for name in names}
    known |= {f"{module}.{name}": known[name] for module, names in found.items() for name in names}
    out.mkdir(parents=True, exist_ok=True)
    shutil.copy(HERE / "style.css", out)
    written = []

    def write(stem: str, title: str, body: str) -> None:
        (out / f"{stem}.html").write_text(framed(title, body, stem, groups), encoding="utf-8")
        written.append(out / f"{stem}.html")

    for stem, title in [item for group, listed in groups.items() if group != "Reference" for item in listed]:
        body = to_html((HERE / f"{stem}.md").read_text(encoding="utf-8"))
        write(stem, title, body)
    rows = []
    for module, names in found.items():
        write(f"reference_{module}", module, module_page(module, names, known))
        rows.append(f'<tr><th colspan="2" scope="rowgroup"><a href="reference_{module}.html">{module}</a></th></tr>')
        for name, item in names.items():
            link = f'<a href="{known[name]}"><code>{qualified(module, name)}</code></a>'
            rows.append(f"<tr><td>{link}</td><td>{inline(summary(item), known)}</td></tr>")
    body = '<h1>All names</h1><p>With <code>import beltrami as bt</code>.</p><div class="scroll"><table>' + "".join(rows) + "</table></div>"
    if rust is not None and (rust / "beltrami" / "index.html").is_file():
        shutil.copytree(rust, out / "rust", dirs_exist_ok=True, ignore=shutil.ignore_patterns(".*"))
        body += '<p>Rust: <a href="rust/beltrami/index.html">the reference of the crate</a>, made by <code>cargo doc</code>.</p>'
    else:
        body += "<p>Rust: <code>cargo doc --no-deps --open</code> makes the reference of the crate.</p>"
    write("reference", "All names", body)
    images = HERE / "images"
    if images.is_dir():
        shutil.copytree(images, out / "images", dirs_exist_ok=True)
    return written


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=HERE.parent / "site", help="folder (site)")
    parser.add_argument("--rust", type=Path, default=HERE.parent / "target" / "doc", help="where cargo doc wrote (target/doc)")
    options = parser.parse_args()
    written = build(options.out, options.rust)
    print(f"wrote {len(written)} pages; open {options.out / 'index.html'}")


if __name__ == "__main__":
    main()
