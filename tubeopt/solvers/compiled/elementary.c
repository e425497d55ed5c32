/* Numbers of one robot, or where ABREAST is 1 of ROBOTS robots side by side, and functions of the C library in line, where
   a call costs more than what it does.

   Sine and cosine of one angle together, within 1.8e-16 of the truth for angles up to 1e5 rad.

   Quarter turns are taken off in two parts (Cody and Waite, 1980); the rest r goes into polynomials through the Chebyshev
   nodes of (sin r / r - 1) / r^2 and (cos r - 1 + r^2 / 2) / r^4 in r^2 up to (pi / 4)^2. Without fused multiplication the
   first step would lose digits, and the functions of the library stay. Not in line: there are hundreds of calls, which
   would take the compiler longer; of two with the same angle it makes one. */
#include <math.h>

#ifndef ABREAST
#define ABREAST 0
#endif

/* As the library's, where one is NaN too. */
static inline double larger(double x, double y) { return x > y || y != y ? x : y; }
static inline double smaller(double x, double y) { return x < y || y != y ? x : y; }

#if !ABREAST
typedef double Real;
typedef int Truth;
#define ROBOTS 1
#define REAL(x) (x)
#define YES 1
#define NOT(truth) (!(truth))
#define ANY(truth) (truth)
#define ALL(truth) (truth)
#define CHOOSE(truth, yes, no) ((truth) ? (yes) : (no))
#define OF_ROBOT(x, which) (x)
#define fmax(x, y) larger(x, y)
#define fmin(x, y) smaller(x, y)
#else
#ifdef __AVX512F__
#define ROBOTS 8
#else
#define ROBOTS 4
#endif
typedef double Real __attribute__((vector_size(ROBOTS * sizeof(double))));
typedef long long Truth __attribute__((vector_size(ROBOTS * sizeof(double)))); /* of each robot 0 or -1 */
#define REAL(x) ((Real){0} + (x))
#define YES ((Truth){0} == 0)
#define NOT(truth) (~(truth))
#define CHOOSE(truth, yes, no) ((Real)(((truth) & (Truth)REAL(yes)) | (~(truth) & (Truth)REAL(no))))
#define OF_ROBOT(x, which) ((x)[which])
#define EACH_ROBOT for (int which = 0; which < ROBOTS; which++)
static inline int ANY(Truth truth) {
    long long any = 0;
    EACH_ROBOT any |= truth[which];
    return any != 0;
}
static inline int ALL(Truth truth) { return !ANY(~truth); }
static inline Real larger_each(Real x, Real y) { return CHOOSE((x > y) | (y != y), x, y); }
static inline Real smaller_each(Real x, Real y) { return CHOOSE((x < y) | (y != y), x, y); }
static inline Real fabs_each(Real x) { return (Real)((Truth)x & 0x7fffffffffffffffLL); }
static inline Real sqrt_each(Real x) {
    Real out;
    EACH_ROBOT out[which] = sqrt(x[which]);
    return out;
}
#define BY_TYPE(x, of_one, of_each) _Generic((x), Real: of_each, default: of_one)
#define fmax(x, y) BY_TYPE((x) + (y), larger, larger_each)(x, y)
#define fmin(x, y) BY_TYPE((x) + (y), smaller, smaller_each)(x, y)
#define sqrt(x) BY_TYPE(x, sqrt, sqrt_each)(x)
#define fabs(x) BY_TYPE(x, fabs, fabs_each)(x)
#endif
/* Whether a number is neither infinite nor NaN. */
#define FINITE(x) (fabs(x) <= 1.7976931348623157e308)

/* Sine s and cosine c of r, at most an eighth of a turn. */
#define SINE_COSINE_SERIES \
    Real y = r * r; \
    Real s = r + r * y * (-0.16666666666666666 + y * (0.008333333333330948 + y * (-0.00019841269836756774 + \
             y * (2.7557316101617874e-06 + y * (-2.505113165023518e-08 + y * 1.5918115263265974e-10))))); \
    Real c = 1 - 0.5 * y + y * y * (0.041666666666666664 + y * (-0.0013888888888887398 + y * (2.480158729876456e-05 + \
             y * (-2.7557317271145144e-07 + y * (2.087614614655861e-09 + y * -1.1382623647474604e-11)))));

#if ABREAST
typedef struct {
    Real sine, cosine;
} SineCosine;

static __attribute__((noinline, const)) SineCosine sine_cosine(Real angle) {
    Real k = angle * 0.6366197723675814, r;
    Truth quarters;
    EACH_ROBOT k[which] = rint(k[which]);
    EACH_ROBOT r[which] = fma(-k[which], 6.123233995736766e-17, fma(-k[which], 1.5707963267948966, angle[which]));
    EACH_ROBOT quarters[which] = (long long)k[which];
    SINE_COSINE_SERIES
    SineCosine out;
    Real sine = CHOOSE((quarters & 1) != 0, c, s), cosine = CHOOSE((quarters & 1) != 0, s, c);
    out.sine = CHOOSE((quarters & 2) != 0, -sine, sine);
    out.cosine = CHOOSE(((quarters + 1) & 2) != 0, -cosine, cosine);
    return out;
}

#define sin(angle) (sine_cosine(angle).sine)
#define cos(angle) (sine_cosine(angle).cosine)
#elif (defined(__GNUC__) || defined(__clang__)) && !defined(TUBEOPT_PORTABLE) && \
    (defined(FP_FAST_FMA) || defined(__FMA__) || defined(__ARM_FEATURE_FMA))
static __attribute__((noinline, const)) _Complex double sine_cosine(double angle) {
    _Complex double out;
    double k = rint(angle * 0.6366197723675814);
    double r = fma(-k, 6.123233995736766e-17, fma(-k, 1.5707963267948966, angle));
    SINE_COSINE_SERIES
    long long quarters = (long long)k;
    double sine = quarters & 1 ? c : s, cosine = quarters & 1 ? s : c;
    __real__ out = (quarters + 1) & 2 ? -cosine : cosine;
    __imag__ out = quarters & 2 ? -sine : sine;
    return out;
}

#define sin(angle) (__imag__ sine_cosine(angle))
#define cos(angle) (__real__ sine_cosine(angle))
#endif

static Real dot(const Real *restrict x, const Real *restrict y, int n) {
    Real sum = {0};
    int k = 0;
#if ABREAST /* compilers do the same with one number each */
    Real part[3] = {{0}};
    for (; k + 4 <= n; k += 4) {
        sum += x[k] * y[k];
        for (int j = 0; j < 3; j++) part[j] += x[k + 1 + j] * y[k + 1 + j];
    }
    sum += part[0] + part[1] + part[2];
#endif
    for (; k < n; k++) sum += x[k] * y[k];
    return sum;
}
