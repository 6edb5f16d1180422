"""The documentation site: pages that are generated from the program, for `mkdocs.yml`."""
