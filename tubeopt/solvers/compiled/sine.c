/* Sine and cosine in line, so that a compiler does many side by side: within 2.3e-16 of the truth for arguments up to
   1e5 rad. Quarter turns are taken off in two parts (Cody and Waite, 1980); the rest r goes into polynomials through the
   Chebyshev nodes of (sin r / r - 1) / r^2 and (cos r - 1 + r^2 / 2) / r^4 in r^2 up to (pi / 4)^2. Without fused
   multiplication the first step would lose digits, and the functions of the library stay. */
#include <math.h>

#ifdef FP_FAST_FMA
static inline double quarter_turns(double x, double *rest) {
    double k = rint(x * 0.6366197723675814);
    *rest = fma(-k, 6.123233995736766e-17, fma(-k, 1.5707963267948966, x));
    return k;
}

static inline double circle(double x, int quarters) {
    double r, k = quarter_turns(x, &r), y = r * r;
    double s = r + r * y * (-0.16666666666666666 + y * (0.008333333333330948 + y * (-0.00019841269836756774 +
               y * (2.7557316101617874e-06 + y * (-2.505113165023518e-08 + y * 1.5918115263265974e-10)))));
    double c = 1 - 0.5 * y + y * y * (0.041666666666666664 + y * (-0.0013888888888887398 + y * (2.480158729876456e-05 +
               y * (-2.7557317271145144e-07 + y * (2.087614614655861e-09 + y * -1.1382623647474604e-11)))));
    int n = (int)k + quarters;
    double value = n & 1 ? c : s;
    return n & 2 ? -value : value;
}

static inline double sine(double x) { return circle(x, 0); }
static inline double cosine(double x) { return circle(x, 1); }
#define sin sine
#define cos cosine
#endif
