"""The generated pages of docs/reference are those of the code."""

import pytest

from tests.docs.reference_pages import FOLDER, MADE, pages

PAGES = pages()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_in_the_repository_is_that_of_the_code(name):
    stored = (FOLDER / name).read_text()
    assert stored == PAGES[name](), "run `python tests/docs/reference_pages.py`"
    assert stored.splitlines()[2].startswith(MADE.partition("{}")[0])
