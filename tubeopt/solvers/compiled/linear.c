/* Dense linear algebra for matrices of a few dozen rows, stored by rows with leading dimension `stride`.

   Cholesky's factors are worked on in squares of four by four, rows and columns filled up with those of the unit matrix
   to a multiple of four: `a` and `x` need room for these. */

#define LANCZOS 48             /* steps for the margin at most */
#define EIGENVALUE_ERROR 1e-10 /* fraction of 1 / margin by which that may be off when they end */
#define ROUGH_ERROR 1e-6       /* the same of margins by which only steps are judged */
#define SOFTENING_ERROR 1e-2   /* allowed error as a fraction of 1 - margin where it only guides a search */
#define LARGE 1e100            /* numbers whose squares do not overflow */
#define CHORD_STEP 1e-3        /* below it, rad, Newton's method keeps its factors */

/* Largest change of the twist at a point in one step from an equilibrium of a margin, rad. */
#define LONGEST_TWIST(margin) fmin(fmax(2 * fabs(margin) * LARGEST_TWIST, SOFT_TWIST), LARGEST_TWIST)

static int filled_up(int n) { return (n + 3) / 4 * 4; }

/* The square at a[0] = R'R, upper triangle in place, with the inverse of R's diagonal; 0 where that cannot be. */
static Truth cholesky_of_four(Real *a, int stride) {
    Truth positive = YES;
    for (int k = 0; k < 4; k++) {
        Real *row = a + k * stride, pivot = row[k];
        positive &= pivot > 1e-13; /* without coupling it is 1: less is rounding */
        if (!ANY(positive)) break;
        row[k] = 1 / sqrt(pivot);
        for (int j = k + 1; j < 4; j++) row[j] *= row[k];
        for (int i = k + 1; i < 4; i++)
            for (int j = i; j < 4; j++) a[i * stride + j] -= row[i] * row[j];
    }
    return positive;
}

/* The first `rows` of `whole` rows of A, both multiples of four, eliminated: of A = (B C; C' D) are left R with B = R'R,
   the inverse of its diagonal on the diagonal, S = R^-T C, and D - S'S, in the upper triangle of a. 0 where B is not
   positive definite. */
static Truth eliminate(Real *a, int rows, int whole, int stride) {
    Truth positive = YES;
    for (int k = 0; k < rows; k += 4) {
        Real *r0 = a + (size_t)k * stride, *r1 = r0 + stride, *r2 = r1 + stride, *r3 = r2 + stride;
        positive &= cholesky_of_four(r0 + k, stride);
        if (!ANY(positive)) break;
        for (int j = k + 4; j < whole; j += 4) {
            EACH(FOUR(r0 + j) *= r0[k]);
            EACH(FOUR(r1 + j) = (FOUR(r1 + j) - r0[k + 1] * FOUR(r0 + j)) * r1[k + 1]);
            EACH(FOUR(r2 + j) = (FOUR(r2 + j) - r0[k + 2] * FOUR(r0 + j) - r1[k + 2] * FOUR(r1 + j)) * r2[k + 2]);
            EACH(FOUR(r3 + j) = (FOUR(r3 + j) - r0[k + 3] * FOUR(r0 + j) - r1[k + 3] * FOUR(r1 + j) -
                                 r2[k + 3] * FOUR(r2 + j)) * r3[k + 3]);
        }
        for (int i = k + 4; i < whole; i += 4) {
            Four f0, f1, f2, f3;
            EACH(OF(f0) = FOUR(r0 + i), OF(f1) = FOUR(r1 + i), OF(f2) = FOUR(r2 + i), OF(f3) = FOUR(r3 + i));
            for (int j = i; j < whole; j += 4) {
                Four v0, v1, v2, v3;
                EACH(OF(v0) = FOUR(r0 + j), OF(v1) = FOUR(r1 + j), OF(v2) = FOUR(r2 + j), OF(v3) = FOUR(r3 + j));
                for (int r = 0; r < 4; r++) {
                    Real *row = a + (size_t)(i + r) * stride + j;
                    EACH(FOUR(row) -= f0[r] * OF(v0) + f1[r] * OF(v1) + f2[r] * OF(v2) + f3[r] * OF(v3));
                }
            }
        }
    }
    return positive;
}

/* Upper R with A = R'R in the upper triangle of a, the inverse of its diagonal on the diagonal; 0 where A is not
   positive definite. */
static Truth cholesky(Real *a, int n, int stride) {
    int whole = filled_up(n);
    for (int r = 0; r < whole; r++)
        for (int j = r < n ? n : 0; j < whole; j++) a[(size_t)r * stride + j] = REAL((double)(r == j));
    return eliminate(a, whole, whole, stride);
}

static Real sum_of_four(Four x) { return (x[0] + x[1]) + (x[2] + x[3]); }

/* Of (x, y) by rows and the rest of `eliminate`: x <- R^-T x, y <- y - S'x. */
static void eliminate_forwards(const Real *a, int rows, int whole, int stride, Real *x) {
    for (int k = 0; k < rows; k += 4) {
        const Real *r0 = a + (size_t)k * stride, *r1 = r0 + stride, *r2 = r1 + stride, *r3 = r2 + stride;
        Real x0 = x[k] * r0[k], x1 = (x[k + 1] - r0[k + 1] * x0) * r1[k + 1];
        Real x2 = (x[k + 2] - r0[k + 2] * x0 - r1[k + 2] * x1) * r2[k + 2];
        Real x3 = (x[k + 3] - r0[k + 3] * x0 - r1[k + 3] * x1 - r2[k + 3] * x2) * r3[k + 3];
        x[k] = x0, x[k + 1] = x1, x[k + 2] = x2, x[k + 3] = x3;
        for (int j = k + 4; j < whole; j += 4)
            EACH(FOUR(x + j) -= x0 * FOUR(r0 + j) + x1 * FOUR(r1 + j) + x2 * FOUR(r2 + j) + x3 * FOUR(r3 + j));
    }
}

/* Of the same: x <- R^-1 (x - S y). */
static void eliminate_backwards(const Real *a, int rows, int whole, int stride, Real *x) {
    for (int k = rows - 4; k >= 0; k -= 4) {
        const Real *r0 = a + (size_t)k * stride, *r1 = r0 + stride, *r2 = r1 + stride, *r3 = r2 + stride;
        Four s0 = {0}, s1 = {0}, s2 = {0}, s3 = {0};
        for (int j = k + 4; j < whole; j += 4) {
            const Real *y = x + j;
            EACH(OF(s0) += FOUR(r0 + j) * FOUR(y));
            EACH(OF(s1) += FOUR(r1 + j) * FOUR(y));
            EACH(OF(s2) += FOUR(r2 + j) * FOUR(y));
            EACH(OF(s3) += FOUR(r3 + j) * FOUR(y));
        }
        Real x3 = (x[k + 3] - sum_of_four(s3)) * r3[k + 3];
        Real x2 = (x[k + 2] - sum_of_four(s2) - r2[k + 3] * x3) * r2[k + 2];
        Real x1 = (x[k + 1] - sum_of_four(s1) - r1[k + 3] * x3 - r1[k + 2] * x2) * r1[k + 1];
        Real x0 = (x[k] - sum_of_four(s0) - r0[k + 3] * x3 - r0[k + 2] * x2 - r0[k + 1] * x1) * r0[k];
        x[k] = x0, x[k + 1] = x1, x[k + 2] = x2, x[k + 3] = x3;
    }
}

/* x <- (R'R)^-1 x */
static void cholesky_solve(const Real *a, int n, int stride, Real *x) {
    int whole = filled_up(n);
    for (int j = n; j < whole; j++) x[j] = REAL(0.0);
    eliminate_forwards(a, whole, whole, stride, x);
    eliminate_backwards(a, whole, whole, stride, x);
}

static Real largest(const Real *x, int n) {
    Real out = {0};
    for (int k = 0; k < n; k++) out = fmax(out, fabs(x[k]));
    return out;
}

#if !ABREAST
/* P A = L R by elimination with partial pivoting, in place; 0 where A is singular. */
static int lu(double *restrict a, int n, int stride, int *pivots) {
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[(size_t)i * stride + k]) > fabs(a[(size_t)pivot * stride + k])) pivot = i;
        double *row = a + (size_t)k * stride, *other = a + (size_t)pivot * stride;
        if (!(fabs(other[k]) > 1e-300)) return 0;
        pivots[k] = pivot;
        for (int j = 0; j < n && pivot != k; j++) {
            double keep = row[j];
            row[j] = other[j];
            other[j] = keep;
        }
        for (int i = k + 1; i < n; i++) {
            double *restrict below = a + (size_t)i * stride;
            double factor = below[k] /= row[k];
            if (factor == 0) continue;
            for (int j = k + 1; j < n; j++) below[j] -= factor * row[j];
        }
    }
    return 1;
}

static void lu_solve(const double *restrict a, int n, int stride, const int *pivots, double *restrict x) {
    for (int k = 0; k < n; k++) {
        double keep = x[pivots[k]];
        x[pivots[k]] = x[k];
        x[k] = keep;
    }
    for (int k = 1; k < n; k++) x[k] -= dot(a + (size_t)k * stride, x, k);
    for (int k = n - 1; k >= 0; k--) {
        const double *row = a + (size_t)k * stride;
        x[k] = (x[k] - dot(row + k + 1, x + k + 1, n - k - 1)) / row[k];
    }
}

#endif

/* A direction that has something of every other. */
static void anywhere(Real *z, int n) {
    for (int k = 0; k < n; k++) z[k] = REAL(1.0 + (7 * k) % 5);
}

/* det(x - H) of an upper Hessenberg matrix of m rows, without what stands more than `band` beside its diagonal, and its first
   two derivatives, each over the product of what stands below the diagonal, by Hyman's method; `y` is left with what solves
   all rows but the first, its last entry 1. */
ALWAYS_INLINE void hyman(const Real *h, int m, int band, Real x, Real *y, Real *out) {
    Real once[LANCZOS], twice[LANCZOS];
    for (int k = 0; k < m; k++) y[k] = once[k] = twice[k] = REAL(0.0);
    y[m - 1] = REAL(1.0);
    for (int i = m - 1; i >= 0; i--) {
        const Real *row = h + (size_t)i * LANCZOS;
        Real value = x * y[i], first = y[i] + x * once[i], second = 2 * once[i] + x * twice[i];
        for (int j = i; j < m && j <= i + band; j++) {
            value -= row[j] * y[j];
            first -= row[j] * once[j];
            second -= row[j] * twice[j];
        }
        if (i) {
            Real below = 1 / row[i - 1];
            y[i - 1] = value * below;
            once[i - 1] = first * below;
            twice[i - 1] = second * below;
            Truth large = fabs(value * below) > LARGE;
            Real by = CHOOSE(large, LARGE, 1.0);
            for (int k = i - 1; k < m && ANY(large); k++) {
                y[k] /= by; /* all that is found is linear in these, and only ratios matter */
                once[k] /= by;
                twice[k] /= by;
            }
        } else {
            out[0] = value;
            out[1] = first;
            out[2] = second;
        }
    }
}

/* Largest eigenvalue of such a matrix all of whose eigenvalues are real, with its eigenvector y of unit length: Laguerre's
   method from the largest sum of a row, which is above all of them, comes down without passing the largest. NAN where it
   does not settle, or is not `asked`. */
ALWAYS_INLINE Real largest_of_hessenberg(const Real *h, int m, int band, Truth asked, Real *y) {
    Real x = {0}, last = REAL(INFINITY), p[3];
    Truth settled = NOT(asked), stuck = settled;
    for (int i = 0; i < m; i++) {
        Real row = {0};
        for (int j = i ? i - 1 : 0; j < m && j <= i + band; j++) row += fabs(h[(size_t)i * LANCZOS + j]);
        x = fmax(x, row);
    }
    for (int step = 0; step < 80; step++) {
        hyman(h, m, band, x, y, p);
        Real first = p[1] / p[0], second = first * first - p[2] / p[0];
        Real spread = (m - 1) * (m * second - first * first), down = m / (first + sqrt(fmax(spread, REAL(0.0))));
        down = CHOOSE(p[0] > 0, down, 0.0); /* at the root, to rounding */
        stuck |= NOT(settled) & NOT(FINITE(down));
        settled |= stuck;
        x -= CHOOSE(settled, 0.0, down);
        /* Where eigenvalues gather, rounding ends the descent. */
        settled |= (fabs(down) <= 1e-14 * fabs(x)) | ((fabs(down) < 1e-6 * fabs(x)) & (fabs(down) > last / 4));
        if (ALL(settled)) break;
        last = fabs(down);
    }
    Real norm = sqrt(dot(y, y, m));
    for (int k = 0; k < m; k++) y[k] /= norm;
    return CHOOSE(settled & NOT(stuck), x, NAN);
}

/* Krylov's method for the largest eigenvalue of an operator x <- A x of n rows with real eigenvalues, most steps up to
   LANCZOS: Lanczos' where A is symmetric, else Arnoldi's. `most` and `small`: see there; (most + 1) rows of length `stride`
   to work in; afterwards whether it settled; and where it is not asked. */
typedef struct {
    void (*apply)(const void *of, Real *x);
    const void *of;
    int symmetric, n, steps, stride;
    Truth settled;
    double small, apart, most;
    Real *basis;
    Truth skipped;
} Krylov;

/* The largest eigenvalue, with full orthogonalisation from `vector`, where its eigenvector is left; -1 where it has none.

   Eigenvalues gather at 1, and the larger ones are 1 / (1 - (1 - margin) / most). It ends where the margin is off by less
   than `small` of it: by the residual, or where A is symmetric by its square over the distance from 1, at least `apart`. */
ALWAYS_INLINE Real largest_of(Krylov *l, Real *vector) {
    Real small[LANCZOS * LANCZOS], y[LANCZOS], value, found[LANCZOS], largest = REAL(-2.0), beside, *basis = l->basis;
    Truth asked = NOT(l->skipped), end = NOT(YES);
    int n = l->n, stride = l->stride, steps = n < l->steps ? n : l->steps, m = 0;
    Real norm = sqrt(dot(vector, vector, n));
    for (int k = 0; k < n; k++) basis[k] = vector[k] / norm;
    memset(found, 0, sizeof found);
    memset(&l->settled, 0, sizeof l->settled);
    for (;; m++) {
        Real *last = basis + (size_t)m * stride, *next = last + stride, *corner = small + m * (LANCZOS + 1);
        memcpy(next, last, n * sizeof(Real));
        l->apply(l->of, next);
        /* Eigenvalues gather at 1: `small` is of A - 1, or rounding would hide how they differ. */
        for (int k = 0; k < n; k++) next[k] -= last[k];
        for (int j = 0; j <= m; j++) small[j * LANCZOS + m] = REAL(0.0);
        for (int pass = 0; pass < 2; pass++) { /* once leaves too little of modes close to one another */
            for (int j = l->symmetric && !pass && m ? m - 1 : 0; j <= m; j++) { /* first what is known not to be 0 */
                const Real *restrict other = basis + (size_t)j * stride;
                Real along = dot(next, other, n);
                small[j * LANCZOS + m] += along;
                for (int k = 0; k < n; k++) next[k] -= along * other[k];
            }
        }
        beside = sqrt(dot(next, next, n));
        end |= m + 1 == n ? YES : beside < 1e-13;
        /* Many steps are many roots: each costs as much as the step. Side by side they are fixed, since what one robot does must
           not depend on the others. */
        if (m + 1 == steps || (ABREAST ? m % 3 == 2 : ANY(end) || (m < 8 ? l->symmetric || m % 2 == 0 : m % 4 == 0))) {
            value = l->symmetric ? largest_of_hessenberg(small, m + 1, 1, asked, y)
                                 : largest_of_hessenberg(small, m + 1, LANCZOS, asked, y);
            largest = CHOOSE(asked, CHOOSE(value > -1, value, -2.0), largest);
            asked &= value > -1;
            for (int j = 0; j <= m; j++) found[j] = CHOOSE(asked, y[j], found[j]);
            Real residual = fabs(beside * y[m]), whole = 1 + value;
            Real within = l->small * whole * (1 + whole * (1 - l->most) / l->most);
            Real off = l->symmetric ? residual * residual / fmax(value, REAL(l->apart)) : residual;
            l->settled |= asked & (end | (off < within));
            asked &= NOT(l->settled);
            if (!ANY(asked) || m + 1 == steps) break;
        }
        corner[LANCZOS] = beside;
        for (int k = 0; k < n; k++) next[k] /= CHOOSE(end, 1.0, beside); /* where it ended, only kept from overflow */
    }
    memset(vector, 0, n * sizeof(Real));
    for (int j = 0; j <= m; j++)
        for (int k = 0; k < n; k++) vector[k] += found[j] * basis[(size_t)j * stride + k];
    return 1 + largest;
}
