import generate
import pytest

TABLES: dict[str, str] = generate.tables()


@pytest.mark.parametrize("name", sorted(TABLES))
def test_the_generated_tables_are_up_to_date(name: str) -> None:
    committed = (generate.REFERENCE / name).read_text(encoding="utf-8")
    assert committed == generate.with_table(committed, TABLES[name]), "run make docs"
