"""Sine and cosine of angles of any size as LLVM IR, for devices without libm.

M. H. Payne and R. N. Hanek, Radian reduction for trigonometric functions, SIGNUM Newsletter 18(1),
1983: x = m 2ᵉ with an integer m, so x · 2/π mod 4 needs only a window of the binary digits of 2/π.
The product of m with a window of 256 digits is exact modulo 2²⁵⁶.
"""

from __future__ import annotations

from ..machine.sincos import PARTS, constant, declarations, rotated_ir

_DIGITS = 1225  # number of binary digits of 2/π that the largest angles need
_WINDOW = 32  # length of a window [bytes]
# Angles below 2²⁰ never reach these functions. Their exponent decides the last window.
_TABLE = (2046 - (1023 + 20) + 7) // 8 + _WINDOW


def _two_over_pi() -> int:
    """Return ⌊2/π · 2^_DIGITS⌋, with π = 16 arctan 1/5 − 4 arctan 1/239 (Machin)."""
    one = 1 << (2 * _DIGITS)

    def inverse_arctan(k: int) -> int:
        power, total, n = one // k, 0, 1
        while power:
            total += power // n if n % 4 == 1 else -(power // n)
            power, n = power // (k * k), n + 2
        return total

    pi = 16 * inverse_arctan(5) - 4 * inverse_arctan(239)
    return (one << (_DIGITS + 1)) // pi


def large_angles_ir() -> str:
    """Generate `double @sin(double)` and `double @cos(double)`, for angles of at least 2²⁰ rad.

    The angles may also be infinite or NaN; the results are then NaN.

    Returns:
        The LLVM IR.
    """
    table = "".join(f"\\{byte:02X}" for byte in _two_over_pi().to_bytes(_TABLE, "little"))
    results = "\n".join(
        f"define double @{name}(double %x) nounwind {{\n"
        "%both = call {double, double} @pinred.large(double %x)\n"
        f"%value = extractvalue {{double, double}} %both, {k}\n"
        "ret double %value\n}"
        for k, name in enumerate(("sin", "cos"))
    )
    return f"""\
{declarations(1)}
declare i256 @llvm.ctlz.i256(i256, i1)
@pinred.two_over_pi = internal constant [{_TABLE} x i8] c"{table}"
{rotated_ir()}
define internal {{double, double}} @pinred.large(double %x) noinline nounwind {{
; |x| = m 2^(exponent - 1075); the quotient |x| 2/π is v 2^-254 mod 4.
%sized = bitcast double %x to i64
%shifted = lshr i64 %sized, 52
%exponent = and i64 %shifted, 2047
%fraction = and i64 %sized, {2**52 - 1}
%m = or i64 %fraction, {2**52}
%digits = sub i64 2046, %exponent
%upwards = add i64 %digits, 7
%byte = lshr i64 %upwards, 3
%whole = shl i64 %byte, 3
%rest = sub i64 %whole, %digits
%at = getelementptr i8, ptr @pinred.two_over_pi, i64 %byte
%window = load i256, ptr %at, align 1
%scaled = shl i64 %m, %rest
%wide = zext i64 %scaled to i256
%v = mul i256 %wide, %window
; The nearest multiple of π/2, and the rest as a signed fraction f 2^-256 of π/2.
%rounded = add i256 %v, {2**253}
%quadrant = lshr i256 %rounded, 254
%q = trunc i256 %quadrant to i64
%f = shl i256 %v, 2
%below = icmp slt i256 %f, 0
%minusf = sub i256 0, %f
%size = select i1 %below, i256 %minusf, i256 %f
; Its 106 highest digits, as two numbers h and l, of which 2^-zeros (h + l) is the fraction.
%zeros = call i256 @llvm.ctlz.i256(i256 %size, i1 false)
%normal = shl i256 %size, %zeros
%highbits = lshr i256 %normal, 203
%high = trunc i256 %highbits to i64
%lowbits = lshr i256 %normal, 150
%lower = trunc i256 %lowbits to i64
%low = and i64 %lower, {2**53 - 1}
%h53 = uitofp i64 %high to double
%l106 = uitofp i64 %low to double
%count = trunc i256 %zeros to i64
%power = sub i64 1023, %count
%scalebits = shl i64 %power, 52
%scale = bitcast i64 %scalebits to double
%h0 = fmul double %h53, {constant(2.0**-53)}
%l0 = fmul double %l106, {constant(2.0**-106)}
%h = fmul double %h0, %scale
%l = fmul double %l0, %scale
; r + e = (h + l) π/2
%r = fmul double %h, {constant(PARTS[0])}
%minusr = fneg double %r
%e0 = call double @llvm.fma.f64(double %h, double {constant(PARTS[0])}, double %minusr)
%e1 = call double @llvm.fma.f64(double %h, double {constant(PARTS[1] + PARTS[2])}, double %e0)
%e = call double @llvm.fma.f64(double %l, double {constant(PARTS[0])}, double %e1)
%minuse = fneg double %e
%rs = select i1 %below, double %minusr, double %r
%es = select i1 %below, double %minuse, double %e
%both = call {{double, double}} @pinred.rotated(double %rs, double %es, i64 %q)
; The sine has the sign of x, and both are NaN for infinities and NaN.
%sine = extractvalue {{double, double}} %both, 0
%cosine = extractvalue {{double, double}} %both, 1
%negative = icmp slt i64 %sized, 0
%minussine = fneg double %sine
%signed = select i1 %negative, double %minussine, double %sine
%nan = fsub double %x, %x
%lastsine = fadd double %signed, %nan
%lastcosine = fadd double %cosine, %nan
%first = insertvalue {{double, double}} poison, double %lastsine, 0
%result = insertvalue {{double, double}} %first, double %lastcosine, 1
ret {{double, double}} %result
}}
{results}
"""
