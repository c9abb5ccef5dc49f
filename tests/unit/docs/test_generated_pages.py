import generate


def test_the_generated_tables_are_up_to_date() -> None:
    tables = generate.tables()
    pages = {name: (generate.REFERENCE / name).read_text(encoding="utf-8") for name in tables}
    stale = [name for name, page in pages.items() if page != generate.with_table(page, tables[name])]
    assert stale == [], "run make docs"
