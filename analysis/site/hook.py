"""Hooks of MkDocs: generated pages, the navigation, formulas, and links to files of the repository."""

from __future__ import annotations

import logging

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from analysis.site.links import linked
from analysis.site.mathematics import Mathematics
from analysis.site.pages import expanded, pictures, texts

LOG = logging.getLogger("mkdocs.hooks.bayescal")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Read formulas."""
    config.markdown_extensions.append(Mathematics())  # type: ignore[arg-type]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and put them into the navigation."""
    for path, content in (texts() | pictures()).items():
        files.append(File.generated(config, path, content=content))
    config.nav = expanded(config.nav, [file.src_uri for file in files.documentation_pages()])
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to files of the repository to their pages."""
    text, broken = linked(markdown, page.file.src_uri)
    for target in broken:
        LOG.warning("%s links to '%s', which does not exist", page.file.src_uri, target)
    return text
