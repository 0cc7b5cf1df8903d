"""The pages as a site: built without a warning, from nothing but the repository."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.scripts import load

import sassgis

pytest.importorskip("material", reason="the site needs the extra docs")
pytest.importorskip("mkdocstrings", reason="the site needs the extra docs")


@pytest.fixture(scope="module")
def site(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(out)]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)[^>]*\bsrc=\"?([^\" >]+)", text)
        loaded += re.findall(r"<link[^>]*rel=\"?(?:stylesheet|preconnect)[^>]*", text)
        assert loaded and not [x for x in loaded if "//" in x], page


def test_the_first_page_is_the_readme_and_its_links_lead_to_pages(site: Path) -> None:
    text = (site / "index.html").read_text(encoding="utf-8")
    assert 'href="maps.html"' in text and 'src="pictures/hazard_level.png"' in text
    assert 'href="samples.html"' in text and 'href="docs/' not in text


def test_every_public_name_is_on_the_page_of_the_interface(site: Path) -> None:
    text = (site / "api.html").read_text(encoding="utf-8")
    for name in set(sassgis.__all__) - {"__version__"}:
        assert f'id="sassgis.{name}"' in text, name


def test_a_link_that_leads_nowhere_is_a_fault(repository: Path, tmp_path: Path) -> None:
    for name in ("docs", "benchmarks", "sample_dem"):
        shutil.copytree(repository / name, tmp_path / name)
    for name in ("mkdocs.yml", "README.md", "CHANGELOG.md"):
        shutil.copy(repository / name, tmp_path / name)
    (tmp_path / "sassgis").symlink_to(repository / "sassgis")
    page = tmp_path / "docs" / "zones.md"
    page.write_text(page.read_text("utf-8") + "\n[x](maps.md#no-such-place)\n", "utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode != 0 and "no-such-place" in done.stderr


def test_links_of_files_become_links_of_pages(repository: Path) -> None:
    linked = load(repository / "docs" / "site_pages.py").linked
    pages = {"maps.md", "studies/fig9.md", "index.md", "changelog.md"}
    assert linked("[a](docs/maps.md#x)", "index.md", pages) == "[a](maps.md#x)"
    assert linked("![a](docs/p.png)", "index.md", {*pages, "p.png"}) == "![a](p.png)"
    assert linked("[a](../CHANGELOG.md)", "maps.md", pages) == "[a](changelog.md)"
    assert linked("[a](../../README.md)", "studies/fig9.md", pages) == "[a](../index.md)"
    assert linked("[a](../pipelines)", "maps.md", pages) == "a"
    assert linked("[a](https://x.y/z) [b](#c)", "maps.md", pages) == "[a](https://x.y/z) [b](#c)"
