"""XML without document types (which declare entities), with a limited number of elements and names."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers.expat import errors

from ronna_hw.bounded_input.refusal import InputRefused

OUT_OF_MEMORY = errors.codes[errors.XML_ERROR_NO_MEMORY]
MOST_ELEMENTS = 100_000  # a camera's description has up to thirty thousand
DEEPEST = 64
NAMES_BYTES = 20_000_000  # in total: a namespace name is repeated in that of every element


def parse_xml(data: bytes, limit_bytes: int) -> ElementTree.Element:
    """The root element. Raises INP-001, also for invalid XML."""
    if len(data) > limit_bytes:
        raise InputRefused("the XML is too large", limit=f"{limit_bytes} bytes", got=str(len(data)))
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(data)
        root: ElementTree.Element = parser.close()
    except InputRefused:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two from an encoding
        if getattr(error, "code", None) == OUT_OF_MEMORY:
            raise MemoryError from error  # which says nothing about the XML
        raise InputRefused(f"not valid XML: {error}") from error
    return root


class _Builder(ElementTree.TreeBuilder):
    def __init__(self) -> None:
        super().__init__()
        self._elements = self._depth = self._names = 0

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        raise InputRefused("XML declares a document type", got=name[:DEEPEST])

    def start(self, tag: str, attributes: dict[str, str]) -> ElementTree.Element:
        self._elements += 1
        self._depth += 1
        self._names += len(tag) + sum(len(name) for name in attributes)
        if self._elements > MOST_ELEMENTS or self._names > NAMES_BYTES:
            raise InputRefused("XML with too many elements", limit=str(MOST_ELEMENTS))
        if self._depth > DEEPEST:
            raise InputRefused("XML nested too deep", limit=f"{DEEPEST} levels")
        return super().start(tag, attributes)

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)
