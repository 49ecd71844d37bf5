"""Sine and cosine of several angles at once, as LLVM IR.

For |x| < 2²⁰ the angle is reduced to |r| ≤ π/4 by three parts of π/2 (Cody and Waite).  With a
fused multiply-add the first step is exact; the rounding errors of the other steps are stored
and added to the result.  Then fdlibm's polynomials are evaluated.  Larger angles, inf and NaN
branch to libm lane by lane, so that the result of a lane does not depend on other lanes.  CPUs
without a fused multiply-add use libm for all angles.
"""

from __future__ import annotations

import struct

LANES = (8, 4, 2, 1)  # supported numbers of angles per batch, in decreasing order

_LIMIT = 2.0**20  # angle above which libm is called [rad]
_MAGIC = 1.5 * 2.0**52  # adding this number rounds to an integer in the lowest bits
_TWO_OVER_PI = float.fromhex("0x1.45f306dc9c883p-1")
# π/2 in parts of 53, 33 and 53 bits, so that 20 bits times the second part are exact.
PARTS = (
    float.fromhex("0x1.921fb54442d18p+0"),
    float.fromhex("0x1.1a62633100000p-54"),
    float.fromhex("0x1.1701b839a2520p-88"),
)
# sin r = r + r³ (S₀ + S₁ r² + …),  cos r = 1 − r²/2 + r⁴ (C₀ + C₁ r² + …)
_SIN = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COS = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip


def constant(value: float) -> str:
    """Format a number such that LLVM reads it without rounding."""
    (bits,) = struct.unpack("<Q", struct.pack("<d", value))
    return f"0x{bits:016X}"


def vector(lanes: int, kind: str = "double") -> str:
    """Return the LLVM type of a value with this many lanes; one lane is a scalar."""
    return kind if lanes == 1 else f"<{lanes} x {kind}>"


def sincos_ir(lanes: int, *, fma: bool) -> str:
    """Generate the function `{T, T} @pinred.sincos<lanes>(T)` and its helpers.

    Args:
        lanes: Number of angles.
        fma: Whether the CPU has a fused multiply-add.
    Returns:
        The LLVM IR.
    """
    declared = declarations(lanes) + _by_libm(lanes)
    if not fma:
        return declared + _forward(lanes)
    return declared + _by_polynomials(lanes)


def declarations(lanes: int) -> str:
    """Generate the declarations of the LLVM intrinsics that the code for these lanes calls."""
    T, B, suffix = vector(lanes), vector(lanes, "i1"), _suffix(lanes)
    lines = [
        f"declare {T} @llvm.fma.{suffix}({T}, {T}, {T})",
        f"declare {T} @llvm.fabs.{suffix}({T})",
        f"declare {T} @llvm.copysign.{suffix}({T}, {T})",
    ]
    if lanes > 1:
        lines.append(f"declare i1 @llvm.vector.reduce.and.v{lanes}i1({B})")
    return "\n".join([*lines, ""])


def _suffix(lanes: int) -> str:
    return "f64" if lanes == 1 else f"v{lanes}f64"


def _by_libm(lanes: int) -> str:
    """Generate `@pinred.libm<lanes>`, an out-of-line loop over the angles."""
    T = vector(lanes)
    lines = [f"define internal {{{T}, {T}}} @pinred.libm{lanes}({T} %x) noinline cold nounwind {{"]
    sine, cosine = "poison", "poison"
    if lanes == 1:
        lines += ["%s = call double @sin(double %x)", "%c = call double @cos(double %x)"]
        sine, cosine = "%s", "%c"
    for k in range(lanes if lanes > 1 else 0):
        lines += [
            f"%x{k} = extractelement {T} %x, i32 {k}",
            f"%s{k} = call double @sin(double %x{k})",
            f"%c{k} = call double @cos(double %x{k})",
            f"%vs{k} = insertelement {T} {sine}, double %s{k}, i32 {k}",
            f"%vc{k} = insertelement {T} {cosine}, double %c{k}, i32 {k}",
        ]
        sine, cosine = f"%vs{k}", f"%vc{k}"
    lines += [
        f"%one = insertvalue {{{T}, {T}}} poison, {T} {sine}, 0",
        f"%both = insertvalue {{{T}, {T}}} %one, {T} {cosine}, 1",
        f"ret {{{T}, {T}}} %both",
        "}\n",
    ]
    return "\n".join(lines)


def _forward(lanes: int) -> str:
    T = vector(lanes)
    return f"""\
define internal {{{T}, {T}}} @pinred.sincos{lanes}({T} %x) alwaysinline nounwind {{
%both = call {{{T}, {T}}} @pinred.libm{lanes}({T} %x)
ret {{{T}, {T}}} %both
}}
"""


class _Lines:
    """The lines of IR of a function of values with several lanes.

    Attributes:
        lanes: Number of lanes.
        text: The lines.
    """

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.text: list[str] = []
        self._type = vector(lanes)

    def number(self, value: float) -> str:
        """Return a constant in all lanes."""
        bits = constant(value)
        return bits if self.lanes == 1 else f"splat (double {bits})"

    def integer(self, value: int) -> str:
        """Return an integer constant in all lanes."""
        return str(value) if self.lanes == 1 else f"splat (i64 {value})"

    def put(self, name: str, text: str) -> str:
        """Add the line that computes a value; return the name of the value."""
        self.text.append(f"%{name} = {text}")
        return f"%{name}"

    def op(self, name: str, what: str, a: str, b: str) -> str:
        """Add an operation of two numbers."""
        return self.put(name, f"{what} {self._type} {a}, {b}")

    def fma(self, name: str, a: str, b: str, c: str) -> str:
        """Add the fused multiply-add a b + c."""
        T = self._type
        return self.put(
            name, f"call {T} @llvm.fma.{_suffix(self.lanes)}({T} {a}, {T} {b}, {T} {c})"
        )


def rotated_ir() -> str:
    """Generate `{double, double} @pinred.rotated(double %r, double %e, i64 %bits)`.

    It computes sine and cosine of r + e + (bits mod 4) π/2 for |r| ≤ π/4, where e is a correction
    of the size of the rounding error of r.

    Returns:
        The LLVM IR.
    """
    lines = _Lines(1)
    sine, cosine = _rotate(lines, *_polynomials(lines))
    body = "\n".join(lines.text)
    return f"""\
define internal {{double, double}} @pinred.rotated(double %r, double %e, i64 %bits) nounwind {{
{body}
%one = insertvalue {{double, double}} poison, double {sine}, 0
%both = insertvalue {{double, double}} %one, double {cosine}, 1
ret {{double, double}} %both
}}
"""


def _polynomials(lines: _Lines) -> tuple[str, str]:
    """Add the lines that compute the sine and the cosine of %r + %e."""
    T, number, put, op, fma = vector(lines.lanes), lines.number, lines.put, lines.op, lines.fma

    def polynomial(name: str, coefficients: tuple[float, ...]) -> str:
        # Evaluate pairs of coefficients in z, which has shorter chains than Horner's scheme.
        a, b, c = (
            fma(f"{name}{k}", "%z", number(coefficients[k + 1]), number(coefficients[k]))
            for k in (0, 2, 4)
        )
        return fma(name, "%zz", fma(f"{name}bc", "%zz", c, b), a)

    z = op("z", "fmul", "%r", "%r")
    op("zz", "fmul", z, z)
    # sin(r + e) = r + (r³ S(z) + e (1 − z/2)).  Copy the sign of r, since −0 + 0 would be +0.
    half = op("half", "fmul", z, number(0.5))
    short = fma("short", put("minushalf", f"fneg {T} {half}"), "%e", "%e")
    tail = fma("tail", op("cube", "fmul", z, "%r"), polynomial("S", _SIN), short)
    sine = op("sine", "fadd", "%r", tail)
    signed = put("signed", f"call {T} @llvm.copysign.{_suffix(lines.lanes)}({T} {sine}, {T} %r)")
    # cos(r + e) = w + (((1 − w) − z/2) + (z² C(z) − r e)),  w = 1 − z/2 rounded
    w = op("w", "fsub", number(1.0), half)
    rounded = op("rounded", "fsub", op("onew", "fsub", number(1.0), w), half)
    small = fma("small", put("minusr", f"fneg {T} %r"), "%e", rounded)
    return signed, op("cosine", "fadd", w, fma("rest", "%zz", polynomial("C", _COS), small))


def _rotate(lines: _Lines, sine: str, cosine: str) -> tuple[str, str]:
    """Add the lines that add the quadrant in the lowest bits of %bits to the angle."""
    T, I, B = (vector(lines.lanes, kind) for kind in ("double", "i64", "i1"))
    integer, put = lines.integer, lines.put
    # Quadrants 1 and 3 exchange sine and cosine.  The sine changes sign in quadrants 2 and 3, the
    # cosine in 1 and 2.
    odd = put("odd", f"trunc {I} %bits to {B}")
    first = put("first", f"select {B} {odd}, {T} {cosine}, {T} {sine}")
    second = put("second", f"select {B} {odd}, {T} {sine}, {T} {cosine}")
    next_bits = put("nextbits", f"add {I} %bits, {integer(1)}")
    results = []
    for name, value, quadrant in (("sin", first, "%bits"), ("cos", second, next_bits)):
        two = put(f"{name}two", f"and {I} {quadrant}, {integer(2)}")
        sign = put(f"{name}sign", f"shl {I} {two}, {integer(62)}")
        plain = put(f"{name}plain", f"bitcast {T} {value} to {I}")
        flipped = put(f"{name}turned", f"xor {I} {plain}, {sign}")
        results.append(put(f"{name}fast", f"bitcast {I} {flipped} to {T}"))
    return results[0], results[1]


def _by_polynomials(lanes: int) -> str:
    T, I, B = (vector(lanes, kind) for kind in ("double", "i64", "i1"))
    lines = _Lines(lanes)
    number, put, op, fma = lines.number, lines.put, lines.op, lines.fma
    pair = f"{{{T}, {T}}}"
    # q = nearest integer to x / (π/2); r + e = x − q π/2, where e is the rounding error of r.
    shifted = fma("shifted", "%x", number(_TWO_OVER_PI), number(_MAGIC))
    q = op("q", "fsub", shifted, number(_MAGIC))
    minus = [number(-summand) for summand in PARTS]
    r1 = fma("r1", q, minus[0], "%x")
    r2 = fma("r2", q, minus[1], r1)
    e2 = fma("e2", q, minus[1], op("d2", "fsub", r1, r2))
    r = fma("r", q, minus[2], r2)
    e3 = fma("e3", q, minus[2], op("d3", "fsub", r2, r))
    op("e", "fadd", e2, e3)
    values = _polynomials(lines)
    # The lowest bits of `shifted` are the quadrant.
    put("bits", f"bitcast {T} {shifted} to {I}")
    sine, cosine = _rotate(lines, *values)
    fast = "\n".join(lines.text)
    all_small = (
        "%ok = and i1 %small.x, true"
        if lanes == 1
        else f"%ok = call i1 @llvm.vector.reduce.and.v{lanes}i1({B} %small.x)"
    )
    return f"""\
define internal {pair} @pinred.sincos{lanes}({T} %x) alwaysinline nounwind {{
%size = call {T} @llvm.fabs.{_suffix(lanes)}({T} %x)
%small.x = fcmp olt {T} %size, {number(_LIMIT)}
{all_small}
{fast}
br i1 %ok, label %done, label %slow, !prof !0
slow:
%libm = call {pair} @pinred.libm{lanes}({T} %x)
%libm.sin = extractvalue {pair} %libm, 0
%libm.cos = extractvalue {pair} %libm, 1
%mixed.sin = select {B} %small.x, {T} {sine}, {T} %libm.sin
%mixed.cos = select {B} %small.x, {T} {cosine}, {T} %libm.cos
br label %done
done:
%both.sin = phi {T} [{sine}, %0], [%mixed.sin, %slow]
%both.cos = phi {T} [{cosine}, %0], [%mixed.cos, %slow]
%one = insertvalue {pair} poison, {T} %both.sin, 0
%both = insertvalue {pair} %one, {T} %both.cos, 1
ret {pair} %both
}}
"""
