/* Sine and cosine in line, so that a compiler does many side by side: within 1e-16 of the truth for arguments up to
   1e5 rad. Reduction by quarter turns in three parts (Cody and Waite, 1980), then the Taylor-like polynomials of least
   error on an eighth of a turn to either side. Without fused multiplication the reduction would lose digits, and the
   library's functions stay. */
#include <math.h>

#ifdef FP_FAST_FMA
static inline double quarter_turns(double x, double *rest) {
    double k = rint(x * 0x1.45f306dc9c883p-1);
    *rest = fma(-k, 0x1.1a62633145c07p-54 /* the rest is k * 3e-33 */, fma(-k, 0x1.921fb54442d18p+0, x));
    return k;
}

static inline double circle(double x, int quarters) {
    double r, k = quarter_turns(x, &r), y = r * r;
    double s = r + r * y * (-0x1.5555555555549p-3 + y * (0x1.111111110f8a6p-7 + y * (-0x1.a01a019c161d5p-13 +
               y * (0x1.71de357b1fe7dp-19 + y * (-0x1.ae5e68a2b9cebp-26 + y * 0x1.5d93a5acfd57cp-33)))));
    double c = 1 - 0.5 * y + y * y * (0x1.555555555554cp-5 + y * (-0x1.6c16c16c15177p-10 + y * (0x1.a01a019cb1590p-16 +
               y * (-0x1.27e4f809c52adp-22 + y * (0x1.1ee9ebdb4b1c4p-29 + y * -0x1.8fae9be8838d4p-37)))));
    int n = (int)k + quarters;
    double value = n & 1 ? c : s;
    return n & 2 ? -value : value;
}

static inline double sine(double x) { return circle(x, 0); }
static inline double cosine(double x) { return circle(x, 1); }
#define sin sine
#define cos cosine
#endif
