"""Names that a program cannot give to a quantity or a coefficient: words of its language, and its own."""

import builtins
import keyword

C_WORDS = """
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false
    asm typeof linux unix main t x u y dxdt acos asin atan atan2 ceil cos cosh exp fabs floor fmod frexp ldexp log log10
    modf pow sin sinh sqrt tan tanh acosh asinh atanh cbrt copysign erf erfc exp2 expm1 fdim fma fmax fmin hypot ilogb
    isfinite isinf isnan isnormal lgamma log1p log2 logb nan nearbyint nextafter remainder rint round scalbn signbit
    tgamma trunc j0 j1 jn y0 y1 yn gamma signgam NAN INFINITY HUGE_VAL HUGE NULL sign_of step_of max_of min_of
    DOMAIN OVERFLOW
    UNDERFLOW SING isgreater isless fpclassify matherr PLOSS TLOSS MAXFLOAT M_E M_LOG2E M_LOG10E M_LN2 M_LN10 M_PI
    M_PI_2 M_PI_4 M_1_PI M_2_PI M_2_SQRTPI M_SQRT2 M_SQRT1_2 FP_NAN FP_INFINITE FP_ZERO FP_SUBNORMAL FP_NORMAL
""".split()
MODELICA_WORDS = """
    algorithm and annotation assert block break class connect connector constant constrainedby der discrete each else
    elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow for function if
    import impure in initial inner input loop model not operator or outer output package parameter partial protected
    public pure record redeclare replaceable return stream then true type when while within time abs sign sqrt div mod
    rem ceil floor integer sin cos tan asin acos atan atan2 sinh cosh tanh exp log log10 pre edge change sample reinit
    smooth noEvent delay homotopy semiLinear min max sum product size fill zeros ones identity Real Integer Boolean
    String StateSelect cat array scalar vector matrix transpose cross skew terminal terminate cardinality ndims
    spatialDistribution
""".split()
PYTHON_WORDS = [*keyword.kwlist, *keyword.softkwlist, *dir(builtins), "numpy", "rhs", "outputs", "t", "x", "u", "g",
                "simulation", "STATES", "INPUTS", "OUTPUTS", "START"]  # fmt: skip
