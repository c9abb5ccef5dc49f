from pathlib import Path

import generate
import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES: dict[str, str] = generate.pages()


@pytest.mark.parametrize("name", sorted(PAGES))
def test_the_generated_page_is_up_to_date(name: str) -> None:
    committed = (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8")
    assert committed == PAGES[name], "run make docs"
