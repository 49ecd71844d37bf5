"""Vector fields of robots with equal limbs for groups of threads, one limb per thread.

The sweep computes equal limbs in lanes, see `reduction/tree/identical_branches.py`.  Here, each
lane becomes a thread: packed symbols are numbers that differ between the threads of a group, and
all other numbers are the same in all of them.  Threads exchange numbers where lanes are summed, and
where one lane is needed alone.  The rest of a graph has an expression for each limb, for example
the sine of each joint angle.  Equal expressions of all limbs become one instruction.

A thread keeps the entries of the state that belong to its limb, and a copy of those that belong to
no limb.  The copies have the same bits, because all threads compute them from the same numbers: a
sum over lanes is added in pairs, in the same order in each thread.  Therefore all threads of a
group take the same branches of the step loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import casadi as ca

from ...common.memo import once
from ...reduction.tree.identical_branches import Lanes, Mark
from ..kernel import Kernel
from ..machine.lowering import BODIES, CALLS, declaration, helper, templates
from ..machine.sincos import constant, sincos_ir
from ..reduced_graph import ReducedGraph

WIDTHS = (2, 4)  # possible numbers of threads in a group
# Largest number of instructions of a thread, relative to those of one thread for all limbs.  A
# device runs fewer members at once if each has several threads, so a smaller saving is lost again.
SHARE = 0.4


@dataclass(frozen=True)
class Group:
    """The vector field of a group of threads, and their entries of the state.

    Attributes:
        places: Index in the state of each entry of each thread, (threads, n).
        own: Number of entries that belong to the limb of a thread; they are the first ones.
        ir: LLVM IR of `rate`, which maps the entries of a thread to their rates.
        instructions: Number of instructions of a thread.
    """

    places: tuple[tuple[int, ...], ...]
    own: int
    ir: str
    instructions: int


def group_of(kernel: Kernel, *, tangent: bool = False) -> Group | None:
    """Return the vector field for groups of threads, None if one thread integrates a member.

    Args:
        kernel: The kernel.
        tangent: Whether runs carry a tangent; these have one thread.
    Returns:
        The vector field, if the robot has two or four equal limbs, or several times as many, and
        each thread executes at most SHARE of the instructions of one thread for all limbs.
    """
    return None if tangent else once(kernel, (group_of, SHARE), lambda: _worthwhile(kernel))


def _worthwhile(kernel: Kernel) -> Group | None:
    lanes = Lanes(joins=False)
    function = ReducedGraph(kernel.system, kernel.structure, kernel.forces, lanes).rate()
    marks = lanes.marks["rate"]
    widths = {mark.width for mark in marks}
    if len(widths) != 1 or not widths <= {*WIDTHS}:
        return None
    expressions = _Expressions(function, marks)
    limbs = expressions.entries_of_limbs()
    first, count = kernel.layout.quaternions
    if limbs is None or limbs.keys() & {*range(first, first + 4 * count)}:
        return None
    group = _Writer(expressions, limbs, *widths).group()
    alone = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate().n_instructions()
    return group if group.instructions <= SHARE * alone else None


# --- expressions ----------------------------------------------------------------------------


class _Node(NamedTuple):
    """An instruction of a CasADi Function, or a Mark.

    Attributes:
        kind: "constant", "input", "operation", or the kind of a Mark.
        numbers: Input and entry, CasADi's operation, or lane.
        operands: Indices of other nodes.
        value: A constant.
    """

    kind: str
    numbers: tuple[int, ...] = ()
    operands: tuple[int, ...] = ()
    value: float = 0.0


# A number of each thread: the node of each; or one node, if it is packed or the same for all.
_Value: TypeAlias = tuple[int, ...]
_Limbs: TypeAlias = dict[int, _Value]  # entries of all limbs that correspond to an entry of one


class _Expressions:
    """The nodes of a Function built by `Lanes`.

    Attributes:
        nodes: The nodes, each after its operands.
        outputs: Node of each entry of the output.
    """

    def __init__(self, function: ca.Function, marks: Sequence[Mark]) -> None:
        self.nodes: list[_Node] = []
        outputs: dict[int, int] = {}
        values: dict[int, int] = {}  # node in each register
        loads: dict[tuple[int, ...], int] = {}
        marked, operands = list[int](), list[int]()
        for k in range(function.n_instructions()):
            op, arguments = function.instruction_id(k), function.instruction_input(k)
            if op == ca.OP_OUTPUT:
                source, (which, entry) = values[arguments[0]], function.instruction_output(k)
                if which == 1:
                    outputs[entry] = source
                    continue
                operands.append(source)
                mark = marks[len(marked)]
                if len(operands) == len(mark.operands):
                    marked.append(self._add(_Node(mark.kind, (mark.lane,), tuple(operands))))
                    operands.clear()
                continue
            place = tuple(arguments)
            if op == ca.OP_CONST:
                new = self._add(_Node("constant", value=float(function.instruction_constant(k))))
            elif op == ca.OP_INPUT and place[0] == function.n_in() - 1:
                new = marked[place[1]]
            elif op == ca.OP_INPUT:
                if place not in loads:
                    loads[place] = self._add(_Node("input", place))
                new = loads[place]
            elif op == ca.OP_ASSIGN:
                new = values[place[0]]
            else:
                new = self._add(_Node("operation", (op,), tuple(values[i] for i in place)))
            values[function.instruction_output(k)[0]] = new
        self.outputs = [outputs[k] for k in range(len(outputs))]
        self._limbs: _Limbs | None = None  # unknown before `entries_of_limbs`

    def _add(self, node: _Node) -> int:
        self.nodes.append(node)
        return len(self.nodes) - 1

    def kind(self, value: _Value) -> str:
        """Return the kind of the nodes of all threads; "choice" if they have nothing in common."""
        members = [self.nodes[k] for k in value]
        first = members[0]
        if len(members) == 1:
            return first.kind
        if any(node.kind != first.kind for node in members):
            return "choice"
        if first.kind == "constant":
            return first.kind
        numbers = [node.numbers for node in members]
        if first.kind == "lane":
            is_own = numbers == [(k,) for k in range(len(members))]
            alike = is_own and all(node.operands == first.operands for node in members)
        elif first.kind == "input":  # parameters of limbs are not looked up
            entries = tuple(entry for _, entry in numbers)
            is_state = all(which == 0 for which, _ in numbers)
            alike = is_state and (self._limbs is None or self._limbs.get(entries[0]) == entries)
        else:
            alike = first.kind == "operation" and len(set(numbers)) == 1
        return first.kind if alike else "choice"

    def operands(self, value: _Value) -> list[_Value]:
        """Return the values from which a value is computed."""
        kind, columns = self.kind(value), [self.nodes[k].operands for k in value]
        if kind == "choice":
            return [(k,) for k in value]
        if kind == "pack":
            return [_joined(columns[0])]
        if len(value) > 1 and kind == "lane":
            return [columns[0]]
        return [_joined(column) for column in zip(*columns, strict=True)]

    def values(self, wanted: Sequence[_Value]) -> Iterator[_Value]:
        """Yield all values that some values need, and these, each after its operands."""
        done, pending = set[_Value](), [*reversed(wanted)]
        while pending:
            missing = [v for v in self.operands(pending[-1]) if v not in done]
            pending += reversed(missing)
            if not missing:
                value = pending.pop()
                if value not in done:
                    done.add(value)
                    yield value

    def entries_of_limbs(self) -> _Limbs | None:
        """Return the entries of the state that belong to limbs, None if one belongs to several."""
        limbs: _Limbs = {}
        packs = [_joined(node.operands) for node in self.nodes if node.kind == "pack"]
        for value in self.values(packs):
            if len(value) > 1 and self.kind(value) == "input":
                entries = tuple(self.nodes[k].numbers[1] for k in value)
                if len({*entries}) < len(entries):
                    return None
                if any(limbs.setdefault(entry, entries) != entries for entry in entries):
                    return None
        self._limbs = limbs
        return limbs


def _joined(nodes: Sequence[int]) -> _Value:
    return (nodes[0],) if len(set(nodes)) == 1 else tuple(nodes)


# --- LLVM IR --------------------------------------------------------------------------------


class _Writer:
    """The lines of IR of a vector field.

    Attributes:
        expressions: The expressions.
        threads: Number of threads.
        rows: Entries of the state that each number of a thread is, by thread.
        own: Number of these numbers that belong to limbs.
    """

    def __init__(self, expressions: _Expressions, limbs: _Limbs, threads: int) -> None:
        self.expressions, self.threads = expressions, threads
        size = len(expressions.outputs)
        own = dict.fromkeys(limbs[k] for k in range(size) if k in limbs)
        self.own = len(own)
        self.rows = [*own, *((k,) * threads for k in range(size) if k not in limbs)]
        self._place = {
            entry: (k, thread if k < self.own else None)
            for k, row in enumerate(self.rows)
            for thread, entry in enumerate(row)
        }
        self._lines: list[str] = []
        self._names: dict[_Value, str] = {}
        self._both: dict[str, str] = {}  # sine and cosine of each angle
        self._table: list[str] = []  # constants that differ between threads
        self._used: set[int] = set()

    def group(self) -> Group:
        """Write the vector field."""
        outputs = self.expressions.outputs
        rates = [_joined([outputs[entry] for entry in row]) for row in self.rows]
        for value in self.expressions.values(rates):
            names = [self._names[operand] for operand in self.expressions.operands(value)]
            self._names[value] = self._written(self.expressions.kind(value), value, names)
        for k, rate in enumerate(rates):
            at = self._put(f"getelementptr double, ptr %out, i64 {k}")
            self._lines.append(f"store double {self._names[rate]}, ptr {at}, align 8")
        calls = {CALLS[op] for op in self._used & CALLS.keys()}
        calls -= {CALLS[ca.OP_FABS], CALLS[ca.OP_COPYSIGN]}  # sines declare them
        places = tuple(zip(*self.rows, strict=True))
        ir = "\n".join([
            *(declaration(*call) for call in sorted(calls)),
            *(helper(op) for op in sorted(self._used & BODIES.keys())),
            sincos_ir(1, fma=True),
            "declare double @sin(double)\ndeclare double @cos(double)",
            f"@pinred.table = internal addrspace(1) constant "
            f"[{len(self._table)} x double] [{', '.join(self._table)}]",
            exchange_ir(self.threads),
            "define void @rate(ptr noalias readonly %y, ptr noalias readonly %params, "
            "ptr noalias %out) nounwind convergent {",
            "%lane = call i64 @pinred.lane()",
            "%table = getelementptr double, ptr addrspace(1) @pinred.table, i64 %lane",
            *self._lines,
            "ret void\n}",
            '!0 = !{!"branch_weights", i32 100000, i32 1}\n!1 = !{}',
        ])  # fmt: skip
        return Group(places, self.own, ir, len(self._lines))

    def _put(self, text: str) -> str:
        name = f"%v{len(self._lines)}"
        self._lines.append(f"{name} = {text}")
        return name

    def _written(self, kind: str, value: _Value, operands: list[str]) -> str:
        """Write the lines that compute a value; return its name."""
        first = self.expressions.nodes[value[0]]
        if kind == "operation":
            return self._operation(first.numbers[0], operands)
        if kind == "constant":
            return self._constant([constant(self.expressions.nodes[k].value) for k in value])
        if kind == "input":
            return self._input(*first.numbers, alone=len(value) == 1)
        if kind == "sum":
            return self._put(f"call double @pinred.sum(double {operands[0]})")
        if kind == "lane" and len(value) == 1:
            return self._of_thread(operands[0], first.numbers[0])
        if kind != "choice":
            return operands[0]  # the number of each thread is that in its lane
        chosen, *others = operands
        for thread, name in enumerate(others, 1):
            condition = self._put(f"icmp eq i64 %lane, {thread}")
            chosen = self._put(f"select i1 {condition}, double {name}, double {chosen}")
        return chosen

    def _operation(self, op: int, operands: list[str]) -> str:
        if op not in (ca.OP_SIN, ca.OP_COS):
            self._used.add(op)
            return self._put(templates()[op].format(*operands, T="double", one=constant(1.0)))
        (angle,) = operands
        if angle not in self._both:
            call = f"call {{double, double}} @pinred.sincos1(double {angle})"
            self._both[angle] = self._put(call)
        return self._put(
            f"extractvalue {{double, double}} {self._both[angle]}, {op == ca.OP_COS:d}"
        )

    def _constant(self, numbers: list[str]) -> str:
        if len(set(numbers)) == 1:
            return numbers[0]
        at = self._put(f"getelementptr double, ptr addrspace(1) %table, i64 {len(self._table)}")
        self._table += [f"double {number}" for number in numbers]
        return self._put(f"load double, ptr addrspace(1) {at}, align 8, !invariant.load !1")

    def _input(self, which: int, entry: int, *, alone: bool) -> str:
        place, thread = (entry, None) if which else self._place[entry]
        at = self._put(f"getelementptr double, ptr %{'params' if which else 'y'}, i64 {place}")
        number = self._put(f"load double, ptr {at}, align 8")
        return self._of_thread(number, thread) if alone and thread is not None else number

    def _of_thread(self, name: str, thread: int) -> str:
        return self._put(f"call double @pinred.of(double {name}, i32 {thread})")


def exchange_ir(threads: int) -> str:
    """Generate the functions by which the threads of a group exchange numbers.

    All threads of a group call them together. `@pinred.lane` is the index of a thread in its group,
    `@pinred.of` the number of one thread, `@pinred.sum` the sum over the numbers of all, and
    `@pinred.first` the smallest of their indices that is not negative, −1 for none.

    Args:
        threads: Number of threads of a group.
    Returns:
        The LLVM IR.
    """
    steps = [1 << k for k in range(threads.bit_length() - 1)]
    sums = "\n".join(
        f"%x{2 * step} = call double @pinred.add(double %x{step}, i32 %mask, i32 {step})"
        for step in steps
    )
    smallest = "\n".join(
        f"%o{step} = call i32 @llvm.nvvm.shfl.sync.bfly.i32(i32 %mask, i32 %k{step}, i32 {step}, "
        f"i32 31)\n"
        f"%c{step} = icmp slt i32 %o{step}, %k{step}\n"
        f"%k{2 * step} = select i1 %c{step}, i32 %o{step}, i32 %k{step}"
        for step in steps
    )
    halves = """\
%bits = bitcast double %x to i64
%low = trunc i64 %bits to i32
%upper = lshr i64 %bits, 32
%high = trunc i64 %upper to i32"""
    joined = """\
%l64 = zext i32 %l to i64
%h64 = zext i32 %h to i64
%hs = shl i64 %h64, 32
%all = or i64 %l64, %hs
%y = bitcast i64 %all to double"""
    # A bound of `idx` in bits 0 to 4, and the bits of the segment in bits 8 to 12.
    segment = (32 - threads) << 8 | 31
    return f"""\
declare i32 @llvm.nvvm.shfl.sync.idx.i32(i32, i32, i32, i32) convergent
declare i32 @llvm.nvvm.shfl.sync.bfly.i32(i32, i32, i32, i32) convergent
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
define i64 @pinred.lane() alwaysinline nounwind {{
%tid = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
%lane = and i32 %tid, {threads - 1}
%wide = zext i32 %lane to i64
ret i64 %wide
}}
define internal i32 @pinred.mask() alwaysinline nounwind {{
%tid = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
%first = and i32 %tid, {32 - threads}
%mask = shl i32 {(1 << threads) - 1}, %first
ret i32 %mask
}}
define internal double @pinred.of(double %x, i32 %thread) alwaysinline nounwind convergent {{
%mask = call i32 @pinred.mask()
{halves}
%l = call i32 @llvm.nvvm.shfl.sync.idx.i32(i32 %mask, i32 %low, i32 %thread, i32 {segment})
%h = call i32 @llvm.nvvm.shfl.sync.idx.i32(i32 %mask, i32 %high, i32 %thread, i32 {segment})
{joined}
ret double %y
}}
define internal double @pinred.add(double %x, i32 %mask, i32 %step)
    alwaysinline nounwind convergent {{
{halves}
%l = call i32 @llvm.nvvm.shfl.sync.bfly.i32(i32 %mask, i32 %low, i32 %step, i32 31)
%h = call i32 @llvm.nvvm.shfl.sync.bfly.i32(i32 %mask, i32 %high, i32 %step, i32 31)
{joined}
%sum = fadd double %x, %y
ret double %sum
}}
define double @pinred.sum(double %x1) alwaysinline nounwind convergent {{
%mask = call i32 @pinred.mask()
{sums}
ret double %x{threads}
}}
define i64 @pinred.first(i64 %index) noinline nounwind convergent {{
%mask = call i32 @pinred.mask()
%isnone = icmp slt i64 %index, 0
%key = select i1 %isnone, i64 {2**31 - 1}, i64 %index
%k1 = trunc i64 %key to i32
{smallest}
%none = icmp eq i32 %k{threads}, {2**31 - 1}
%wide = sext i32 %k{threads} to i64
%first = select i1 %none, i64 -1, i64 %wide
ret i64 %first
}}
"""
