/* Functions of the C library in line, where a call costs more than what it does.

   Sine and cosine of one angle together, within 1.8e-16 of the truth for angles up to 1e5 rad.

   Quarter turns are taken off in two parts (Cody and Waite, 1980); the rest r goes into polynomials through the Chebyshev
   nodes of (sin r / r - 1) / r^2 and (cos r - 1 + r^2 / 2) / r^4 in r^2 up to (pi / 4)^2. Without fused multiplication the
   first step would lose digits, and the functions of the library stay. Not in line: there are hundreds of calls, which
   would take the compiler longer; of two with the same angle it makes one. */
#include <math.h>

/* As the library's, where one is NaN too. */
static inline double larger(double x, double y) { return x > y || y != y ? x : y; }
static inline double smaller(double x, double y) { return x < y || y != y ? x : y; }
#define fmax(x, y) larger(x, y)
#define fmin(x, y) smaller(x, y)

#if (defined(__GNUC__) || defined(__clang__)) && !defined(TUBEOPT_PORTABLE) && \
    (defined(FP_FAST_FMA) || defined(__FMA__) || defined(__ARM_FEATURE_FMA))
static __attribute__((noinline, const)) _Complex double sine_cosine(double angle) {
    _Complex double out;
    double k = rint(angle * 0.6366197723675814);
    double r = fma(-k, 6.123233995736766e-17, fma(-k, 1.5707963267948966, angle)), y = r * r;
    double s = r + r * y * (-0.16666666666666666 + y * (0.008333333333330948 + y * (-0.00019841269836756774 +
               y * (2.7557316101617874e-06 + y * (-2.505113165023518e-08 + y * 1.5918115263265974e-10)))));
    double c = 1 - 0.5 * y + y * y * (0.041666666666666664 + y * (-0.0013888888888887398 + y * (2.480158729876456e-05 +
               y * (-2.7557317271145144e-07 + y * (2.087614614655861e-09 + y * -1.1382623647474604e-11)))));
    long long quarters = (long long)k;
    double sine = quarters & 1 ? c : s, cosine = quarters & 1 ? s : c;
    __real__ out = (quarters + 1) & 2 ? -cosine : cosine;
    __imag__ out = quarters & 2 ? -sine : sine;
    return out;
}

#define sin(angle) (__imag__ sine_cosine(angle))
#define cos(angle) (__real__ sine_cosine(angle))
#endif

static double dot(const double *restrict x, const double *restrict y, int n) {
    double sum = 0;
    for (int k = 0; k < n; k++) sum += x[k] * y[k];
    return sum;
}
