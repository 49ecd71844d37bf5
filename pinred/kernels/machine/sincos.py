"""Sine and cosine together, of several angles at once, as LLVM IR.

For |x| < 2²⁰ the angle is reduced to |r| ≤ π/4 by three parts of π/2 (Cody and Waite): with
a fused multiply-add the first step is exact, and what the others round away is kept and
added to the result.  Then fdlibm's polynomials.  Larger angles, inf and NaN take a branch
to libm, each in its lane: no lane's numbers depend on what the others hold.  On a CPU that has no
fused multiply-add everything does.
"""

from __future__ import annotations

import struct

LANES = (8, 4, 2, 1)  # how many angles at once, the widest first

_LIMIT = 2.0**20
_MAGIC = 1.5 * 2.0**52  # added to a number, it leaves the nearest integer in the lowest bits
_TWO_OVER_PI = float.fromhex("0x1.45f306dc9c883p-1")
# π/2 in parts of 53, 33 and 53 bits: 20 bits times the second are exact.
_PARTS = (
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
    """Return a number as LLVM reads it without rounding."""
    (bits,) = struct.unpack("<Q", struct.pack("<d", value))
    return f"0x{bits:016X}"


def vector(lanes: int, kind: str = "double") -> str:
    """Return the type of a value with this many lanes; one lane is a scalar."""
    return kind if lanes == 1 else f"<{lanes} x {kind}>"


def sincos_ir(lanes: int, *, fma: bool) -> str:
    """Return the function `{T, T} @pinred.sincos<lanes>(T)`, and those that it calls.

    fma: whether the CPU has a fused multiply-add.
    """
    declared = _declarations(lanes) + _by_libm(lanes)
    return declared + (_by_polynomials(lanes) if fma else _forward(lanes))


def _declarations(lanes: int) -> str:
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
    """Return `@pinred.libm<lanes>`: one angle after another, out of line."""
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


def _by_polynomials(lanes: int) -> str:
    T, I, B = (vector(lanes, kind) for kind in ("double", "i64", "i1"))
    lines: list[str] = []

    def number(value: float) -> str:
        return constant(value) if lanes == 1 else f"splat (double {constant(value)})"

    def integer(value: int) -> str:
        return str(value) if lanes == 1 else f"splat (i64 {value})"

    def put(name: str, text: str) -> str:
        lines.append(f"%{name} = {text}")
        return f"%{name}"

    def op(name: str, what: str, a: str, b: str) -> str:
        return put(name, f"{what} {T} {a}, {b}")

    def fma(name: str, a: str, b: str, c: str) -> str:
        return put(name, f"call {T} @llvm.fma.{_suffix(lanes)}({T} {a}, {T} {b}, {T} {c})")

    def polynomial(name: str, coefficients: tuple[float, ...]) -> str:
        # In z, in pairs: shorter chains than one coefficient after another.
        a, b, c = (
            fma(f"{name}{k}", "%z", number(coefficients[k + 1]), number(coefficients[k]))
            for k in (0, 2, 4)
        )
        return fma(name, "%zz", fma(f"{name}bc", "%zz", c, b), a)

    # q = nearest integer to x / (π/2); r + e = x − q π/2, where e is what r cannot hold.
    shifted = fma("shifted", "%x", number(_TWO_OVER_PI), number(_MAGIC))
    q = op("q", "fsub", shifted, number(_MAGIC))
    minus = [number(-part) for part in _PARTS]
    r1 = fma("r1", q, minus[0], "%x")
    r2 = fma("r2", q, minus[1], r1)
    e2 = fma("e2", q, minus[1], op("d2", "fsub", r1, r2))
    r = fma("r", q, minus[2], r2)
    e3 = fma("e3", q, minus[2], op("d3", "fsub", r2, r))
    e = op("e", "fadd", e2, e3)
    z = op("z", "fmul", r, r)
    op("zz", "fmul", z, z)
    # sin(r + e) = r + (r³ S(z) + e (1 − z/2)).  The sign is r's even where the sum is −0 + 0.
    half = op("half", "fmul", z, number(0.5))
    short = fma("short", put("minushalf", f"fneg {T} {half}"), e, e)
    tail = fma("tail", op("cube", "fmul", z, r), polynomial("S", _SIN), short)
    sine = op("sine", "fadd", r, tail)
    signed = put("signed", f"call {T} @llvm.copysign.{_suffix(lanes)}({T} {sine}, {T} {r})")
    # cos(r + e) = w + (((1 − w) − z/2) + (z² C(z) − r e)),  w = 1 − z/2 rounded
    w = op("w", "fsub", number(1.0), half)
    rounded = op("rounded", "fsub", op("onew", "fsub", number(1.0), w), half)
    small = fma("small", put("minusr", f"fneg {T} {r}"), e, rounded)
    cosine = op("cosine", "fadd", w, fma("rest", "%zz", polynomial("C", _COS), small))
    # The quadrant is in the lowest bits of `shifted`.  1, 3: exchange.  2, 3: sin changes its
    # sign.  1, 2: cos does.
    bits = put("bits", f"bitcast {T} {shifted} to {I}")
    odd = put("odd", f"trunc {I} {bits} to {B}")
    first = put("first", f"select {B} {odd}, {T} {cosine}, {T} {signed}")
    second = put("second", f"select {B} {odd}, {T} {signed}, {T} {cosine}")
    next_bits = put("nextbits", f"add {I} {bits}, {integer(1)}")
    results = []
    for name, value, quadrant in (("sin", first, bits), ("cos", second, next_bits)):
        two = put(f"{name}two", f"and {I} {quadrant}, {integer(2)}")
        sign = put(f"{name}sign", f"shl {I} {two}, {integer(62)}")
        plain = put(f"{name}plain", f"bitcast {T} {value} to {I}")
        turned = put(f"{name}turned", f"xor {I} {plain}, {sign}")
        results.append(put(f"{name}fast", f"bitcast {I} {turned} to {T}"))
    fast = "\n".join(lines)
    all_small = (
        "%ok = and i1 %small.x, true"
        if lanes == 1
        else f"%ok = call i1 @llvm.vector.reduce.and.v{lanes}i1({B} %small.x)"
    )
    pair = f"{{{T}, {T}}}"
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
%mixed.sin = select {B} %small.x, {T} {results[0]}, {T} %libm.sin
%mixed.cos = select {B} %small.x, {T} {results[1]}, {T} %libm.cos
br label %done
done:
%both.sin = phi {T} [{results[0]}, %0], [%mixed.sin, %slow]
%both.cos = phi {T} [{results[1]}, %0], [%mixed.cos, %slow]
%one = insertvalue {pair} poison, {T} %both.sin, 0
%both = insertvalue {pair} %one, {T} %both.cos, 1
ret {pair} %both
}}
"""
