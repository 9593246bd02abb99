"""What mkdocs calls to build the site: adds the pages that are not files of docs/.

README.md and the other documents at the top are pages, the examples are the tutorials, and each
command and rule has a page made from the code. Links between documents lead to their pages; where
a link leads to a file that is not in the site, its text stays.
"""

import logging
import re
import sys
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from docs.site import generated  # noqa: E402 -- after the path

EXAMPLES = sorted(ROOT.glob("examples/*/README.md"))
ADDED = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "tests/interop/README.md": "explanation/tested.md",
    **{str(path.relative_to(ROOT)): f"tutorials/{path.parent.name}.md" for path in EXAMPLES},
}
"""A document outside docs/ -> its page."""
ORIGINS = {page: document for document, page in ADDED.items()}
RULES = f"{generated.RULES}.md"
ALL_COMMANDS = "reference/all-commands.md"
"""On code hosts one page; the site has one for each command."""
_LINK = re.compile(r"\[((?:[^\[\]`]|`[^`]*`)*)\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
_FENCE = re.compile(r"(?ms)^(```.*?^```$)")
_FETCHED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)=[\"']?(https?:[^\"'> ]*)")
_log = logging.getLogger("mkdocs.hooks.site")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the generated pages and the decisions into the navigation."""
    rules = (ROOT / "docs" / RULES).read_text()
    decisions = sorted((ROOT / "docs/explanation/adr").glob("*.md"))
    pages = {
        "COMMANDS": list(generated.command_pages()),
        "RULES": [RULES, *generated.rule_pages(rules)],
        "DECISIONS": [f"explanation/adr/{path.name}" for path in decisions],
    }
    for section in config.nav:
        for entries in section.values():
            for entry in entries if isinstance(entries, list) else ():
                for title, name in entry.items():
                    entry[title] = pages.get(name, name)
    return config


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the documents outside docs/, and the generated pages."""
    rules = (ROOT / "docs" / RULES).read_text()
    for document, page in ADDED.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / document)))
    for page, text in {**generated.command_pages(), **generated.rule_pages(rules)}.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead the links of a document to pages of the site."""
    del config
    here = page.file.src_uri
    if here.startswith((f"{generated.COMMANDS}/", f"{generated.RULES}/")):
        return markdown
    if here == RULES:
        markdown = generated.rule_index(markdown)

    def link(found: re.Match[str]) -> str:
        text, target, anchor = found[1], found[2], found[3]
        if not target or ":" in target:
            return found[0]
        document = normpath(join(dirname(_document_of(here)), target))
        page, anchor = _page_of(document, anchor)
        if files.get_file_from_path(page) is None and (ROOT / document).exists():
            return text
        return f"[{text}]({relpath(page, dirname(here) or '.')}{f'#{anchor}' if anchor else ''})"

    parts = _FENCE.split(markdown)
    return "".join(part if part.startswith("```") else _LINK.sub(link, part) for part in parts)


def on_post_page(output: str, *, page: Page, config: MkDocsConfig) -> str:
    """Warn of what a browser would fetch from elsewhere: the reader's network may be closed."""
    own = config.site_url or "its address is not known"
    for address in _FETCHED.findall(output):
        if not address.startswith(own):
            _log.warning("%s fetches %s", page.file.src_uri, address)
    return output


def _document_of(page: str) -> str:
    """The path in the checkout of what became this page."""
    return ORIGINS.get(page, f"docs/{page}")


def _page_of(document: str, anchor: str | None) -> tuple[str, str | None]:
    """The page that a document became, and the anchor in it."""
    page = ADDED.get(document, document.removeprefix("docs/"))
    if page == ALL_COMMANDS:
        name = (anchor or "index").removeprefix("pqsec-")
        return f"{generated.COMMANDS}/{name}.md", None
    if page == RULES and anchor and (rule := re.match("pqs[0-9]{3}", anchor)):
        return f"{generated.RULES}/{rule[0].upper()}.md", None
    return page, anchor
