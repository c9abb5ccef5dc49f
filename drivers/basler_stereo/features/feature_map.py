"""Camera features by name, resolved to registers through the nodes of the description.

Supported nodes: Integer, Boolean, Enumeration, Float, Command, IntReg, MaskedIntReg, StructReg, FloatReg,
Converter, IntConverter, SwissKnife and IntSwissKnife. One description often serves several models: a feature
whose conditions are false counts as absent. Nothing is cached, since a camera may change values on its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.basler_stereo.control_channel import CameraControl
from drivers.basler_stereo.errors import BAD_DESCRIPTION, MISSING_FEATURE
from drivers.basler_stereo.features.description import (
    ADDRESS_LIMIT,
    CONDITIONS,
    Field,
    Node,
    Number,
    decode_register,
    encode_register,
    parse_real_number,
    parse_whole_number,
    register_length,
    shares_register,
)
from drivers.basler_stereo.features.formula import evaluate
from ronna_hw.wire.gige_vision import REGISTER_BYTES

DEPTH_LIMIT = 24  # nodes between a feature and its register; more is a cycle
# Limit for one call, in fields of visited nodes and characters of formulas: nodes that each refer to two
# others double the cost with every level. Features of real cameras cost some hundreds.
COST_LIMIT = 100_000
REGISTER_COST = 100  # for a query to the camera: a thousand of them take a second
_WHOLE = {"IntSwissKnife", "IntConverter"}
_CONVERTERS = {"Converter", "IntConverter"}
_REGISTERS = {"IntReg", "MaskedIntReg", "FloatReg"}


@dataclass(frozen=True)
class Limits:
    """Minimum, maximum and step of a value; None if the description states none."""

    minimum: Number | None
    maximum: Number | None
    step: Number | None


class RegisterMemory:
    """Camera memory, accessed over the control channel with the deadline `deadline_s`."""

    def __init__(self, control: CameraControl) -> None:
        self._control = control
        self.deadline_s = 0.0

    def read(self, address: int, count: int) -> bytes:
        """Read a multiple of 4 bytes; raises GEV-006, GEV-007, GEV-008."""
        if count == REGISTER_BYTES:
            return self._control.read_register(address, self.deadline_s).to_bytes(REGISTER_BYTES, "big")
        return self._control.read_memory(address, count, self.deadline_s)

    def write(self, address: int, data: bytes) -> None:
        """Write a multiple of 4 bytes; raises GEV-006, GEV-007."""
        if len(data) == REGISTER_BYTES:
            self._control.write_register(address, int.from_bytes(data, "big"), self.deadline_s)
        else:
            self._control.write_memory(address, data, self.deadline_s)


class FeatureMap:
    """Features of one camera; unknown names or values raise GEV-010, inconsistent nodes GEV-009."""

    def __init__(self, nodes: dict[str, Node], memory: RegisterMemory) -> None:
        self._nodes = nodes
        self._memory = memory
        self._local_values: dict[str, Number] = {}  # nodes with their own value and no register
        self._budget = COST_LIMIT

    def has(self, name: str) -> bool:
        """Return whether the feature exists and is currently available."""
        self._budget = COST_LIMIT
        return name in self._nodes and self._is_available(name, 0)

    def entries(self, name: str) -> dict[str, int]:
        """Return the available entries of an enumeration, by name."""
        self._budget = COST_LIMIT
        node = self._find_node(name)
        return {
            entry: value
            for entry, value in node.entries.items()
            if all(self._read(condition, 1) for condition in node.conditions.get(entry, ()))
        }

    def number(self, name: str) -> Number:
        """Read a numeric feature."""
        self._budget = COST_LIMIT
        return self._read(name, 0)

    def choice(self, name: str) -> str:
        """Read an enumeration and return its entry name."""
        value = int(self.number(name))
        for entry, number in self._find_node(name).entries.items():
            if number == value:
                return entry
        raise BAD_DESCRIPTION(f"{name} has the value {value}, which is not among its entries")

    def set_number(self, name: str, value: Number) -> None:
        """Set a numeric feature; the camera checks the value."""
        self._budget = COST_LIMIT
        self._write(name, value, 0)

    def choose(self, name: str, entry: str) -> None:
        """Set an enumeration by entry name."""
        entries = self.entries(name)
        if entry not in entries:
            raise MISSING_FEATURE(f"{name} cannot be {entry}", expected=" or ".join(sorted(entries)))
        self._write(name, entries[entry], 0)

    def execute(self, name: str) -> None:
        """Execute a command feature."""
        self._memory.write(*self.command_write(name))

    def command_write(self, name: str) -> tuple[int, bytes]:
        """Return the address and bytes that execute a command feature."""
        self._budget = COST_LIMIT
        node = self._find_node(name)
        if node.kind != "Command":
            raise MISSING_FEATURE(f"{name} is not a command", got=node.kind)
        value = self._read_field_number(node, "CommandValue", 0)
        register = self._final_register(node.text("pValue") or "", 0)
        data = self._encode_value(register, 1 if value is None else value)
        return self._register_address(register, 0), data

    def limits(self, name: str) -> Limits:
        """Return a feature's current limits; any not stated come from the nodes below it."""
        self._budget = COST_LIMIT
        node: Node | None = self._find_node(name)
        found: list[Number | None] = [None, None, None]
        depth = 0
        while node is not None and depth < DEPTH_LIMIT:
            for place, tag in enumerate(("Min", "Max", "Inc")):
                if found[place] is None:
                    found[place] = self._read_field_number(node, tag, depth)
            child_name = self._value_node_name(node, depth) if node.kind not in _CONVERTERS else None
            node = self._find_node(child_name) if child_name else None
            depth += 1
        return Limits(*found)

    def _find_node(self, name: str) -> Node:
        try:
            return self._nodes[name]
        except KeyError:
            raise MISSING_FEATURE(f"the camera has no feature {name}") from None

    def _read(self, name: str, depth: int) -> Number:
        node = self._visit(name, depth)
        if node.kind in _REGISTERS:
            return self._read_register(node, depth)
        if node.kind.endswith("SwissKnife"):
            return self._evaluate_node(node, "Formula", depth)
        child_name = self._value_node_name(node, depth)
        if node.kind in _CONVERTERS:
            return self._evaluate_node(node, "FormulaFrom", depth, TO=self._read(child_name or "", depth + 1))
        if child_name is not None:
            value = self._read(child_name, depth + 1)
            return float(value) if node.kind == "Float" else value
        if name in self._local_values:
            return self._local_values[name]
        if (own := node.text("Value")) is None:
            raise BAD_DESCRIPTION(f"{name} ({node.kind}) has no value")
        return parse_real_number(own, name) if node.kind == "Float" else parse_whole_number(own, name)

    def _write(self, name: str, value: Number, depth: int) -> None:
        node = self._visit(name, depth)
        if node.kind in _REGISTERS:
            self._memory.write(self._register_address(node, depth), self._encode_value(node, value))
            return
        child_name = self._value_node_name(node, depth)
        if node.kind in _CONVERTERS:
            self._write(
                child_name or "", self._evaluate_node(node, "FormulaTo", depth, FROM=value), depth + 1
            )
        elif child_name is not None:
            self._write(child_name, value, depth + 1)
        elif node.text("Value") is not None:
            self._local_values[name] = value
        else:
            raise MISSING_FEATURE(f"{name} cannot be written", got=node.kind)

    def _visit(self, name: str, depth: int) -> Node:
        if depth > DEPTH_LIMIT:
            raise BAD_DESCRIPTION(f"the nodes below {name} form a cycle")
        node = self._find_node(name)
        self._spend(1 + len(node.fields), name)
        return node

    def _spend(self, cost: int, name: str) -> None:
        self._budget -= cost
        if self._budget < 0:
            raise BAD_DESCRIPTION(f"too many nodes below {name}", limit=f"a cost of {COST_LIMIT}")

    def _final_register(self, name: str, depth: int) -> Node:
        node = self._visit(name, depth)
        if node.kind in _REGISTERS:
            return node
        return self._final_register(self._value_node_name(node, depth) or "", depth + 1)

    def _is_available(self, name: str, depth: int) -> bool:
        """Return whether a feature's conditions are met, including those of its value nodes."""
        node = self._visit(name, depth)
        for tag in CONDITIONS:
            if not all(self._read(field.text, depth + 1) for field in node.all(tag)):
                return False
        child_name = self._value_node_name(node, depth)
        return child_name is None or self._is_available(child_name, depth + 1)

    def _value_node_name(self, node: Node, depth: int) -> str | None:
        """Return the name of the node that holds a node's value, selected by its index if it has several."""
        index_node = None if node.kind in _REGISTERS else node.text("pIndex")
        if index_node is None:
            return node.text("pValue")
        index = int(self._read(index_node, depth + 1))
        for field in node.all("pValueIndexed"):
            if parse_whole_number(field.attributes.get("Index"), f"index of {node.name}") == index:
                return field.text
        return node.text("pValueDefault")

    def _read_field_number(self, node: Node, tag: str, depth: int) -> Number | None:
        """Read a number from a field or from the node that its `p...` variant refers to, if either exists."""
        own, other = node.text(tag), node.text(f"p{tag}")
        if own is not None:
            read = parse_real_number if node.kind == "Float" else parse_whole_number
            return read(own, f"{tag} of {node.name}")
        return None if other is None else self._read(other, depth + 1)

    def _evaluate_node(self, node: Node, tag: str, depth: int, **given: Number) -> Number:
        """Evaluate a node's formula with its variables, constants and expressions."""
        values = dict(given)
        for field in node.fields:
            name = field.attributes.get("Name", "")
            if field.tag == "pVariable":
                values[name] = self._read(field.text.split(".")[0], depth + 1)
            elif field.tag in ("Constant", "Expression"):
                values[name] = self._evaluate_formula(field.text, values, node)
        if (formula := node.text(tag)) is None:
            raise BAD_DESCRIPTION(f"{node.name} has no {tag}")
        return self._evaluate_formula(formula, values, node)

    def _evaluate_formula(self, formula: str, values: dict[str, Number], node: Node) -> Number:
        self._spend(len(formula), node.name)
        return evaluate(formula, values, whole=node.kind in _WHOLE)

    def _register_address(self, node: Node, depth: int) -> int:
        address = sum(
            parse_whole_number(field.text, f"address of {node.name}") for field in node.all("Address")
        )
        address += sum(int(self._read(field.text, depth + 1)) for field in node.all("pAddress"))
        for field in node.all("pIndex"):
            address += int(self._read(field.text, depth + 1)) * self._read_index_step(field, node, depth)
        if not 0 <= address < ADDRESS_LIMIT:
            raise BAD_DESCRIPTION(f"{node.name} is at an impossible address", got=f"{address}")
        return address

    def _read_index_step(self, field: Field, node: Node, depth: int) -> int:
        if "pOffset" in field.attributes:
            return int(self._read(field.attributes["pOffset"], depth + 1))
        if "Offset" in field.attributes:
            return parse_whole_number(field.attributes["Offset"], f"index of {node.name}")
        return register_length(node)

    def _read_register(self, node: Node, depth: int) -> Number:
        length = register_length(node)
        self._spend(REGISTER_COST, node.name)
        padded = -(-length // REGISTER_BYTES) * REGISTER_BYTES
        return decode_register(node, self._memory.read(self._register_address(node, depth), padded)[:length])

    def _encode_value(self, node: Node, value: Number) -> bytes:
        length = register_length(node)
        if length % REGISTER_BYTES:
            raise MISSING_FEATURE(
                f"{node.name} cannot be written",
                expected=f"a multiple of {REGISTER_BYTES} bytes",
                got=f"{length} bytes",
            )
        current = b""
        if shares_register(node):
            current = self._memory.read(self._register_address(node, 0), length)
        return encode_register(node, value, current)
