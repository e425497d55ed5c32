/* Dense linear algebra for matrices of a few dozen rows, stored by rows with leading dimension `stride`. */

/* Upper R with A = R'R in the upper triangle of a; 0 where A is not positive definite. */
static int cholesky(double *restrict a, int n, int stride) {
    for (int k = 0; k < n; k++) {
        double *row = a + (size_t)k * stride;
        if (!(row[k] > 1e-13)) return 0;
        double inverse = 1 / sqrt(row[k]);
        for (int j = k; j < n; j++) row[j] *= inverse;
        for (int i = k + 1; i < n; i++) {
            double *restrict below = a + (size_t)i * stride;
            double factor = row[i];
            for (int j = i; j < n; j++) below[j] -= factor * row[j];
        }
    }
    return 1;
}

/* x <- (R'R)^-1 x */
static void cholesky_solve(const double *restrict a, int n, int stride, double *restrict x) {
    for (int k = 0; k < n; k++) {
        const double *row = a + (size_t)k * stride;
        double value = x[k] / row[k];
        x[k] = value;
        for (int j = k + 1; j < n; j++) x[j] -= row[j] * value;
    }
    for (int k = n - 1; k >= 0; k--) {
        const double *row = a + (size_t)k * stride;
        double sum = x[k];
        for (int j = k + 1; j < n; j++) sum -= row[j] * x[j];
        x[k] = sum / row[k];
    }
}

static double dot(const double *restrict x, const double *restrict y, int n) {
    double sum = 0;
    for (int k = 0; k < n; k++) sum += x[k] * y[k];
    return sum;
}

static double largest(const double *x, int n) {
    double out = 0;
    for (int k = 0; k < n; k++) out = fmax(out, fabs(x[k]));
    return out;
}

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

/* Largest eigenvalue of the symmetric tridiagonal matrix (d, e) of n rows, not below `least`, by bisection on
   the Sturm sequence. */
static double largest_of_tridiagonal(const double *d, const double *e, int n, double least) {
    double low = fmax(d[0], least), high = low;
    for (int i = 0; i < n; i++) {
        double reach = (i ? fabs(e[i - 1]) : 0) + (i + 1 < n ? fabs(e[i]) : 0);
        low = fmax(low, d[i]);
        high = fmax(high, d[i] + reach);
    }
    for (int step = 0; step < 60 && high - low > 1e-13 * high; step++) {
        double x = (low + high) / 2, q = 1;
        int above = 0;
        for (int i = 0; i < n; i++) {
            q = d[i] - x - (i ? e[i - 1] * e[i - 1] / q : 0);
            if (fabs(q) < 1e-300) q = 1e-300;
            above += q > 0;
        }
        if (above) low = x; else high = x;
    }
    return (low + high) / 2;
}

/* Least eigenvalue of A = R'R (cholesky): the largest of its inverse by Lanczos with reorthogonalisation from `vector`,
   where the eigenvector is left if `wanted`. */
static double least_eigenvalue(const double *r, int n, int stride, double *vector, int wanted) {
    double basis[LANCZOS + 1][MOST_UNKNOWNS], diagonal[LANCZOS], beside[LANCZOS], value = 0;
    int steps = n < LANCZOS ? n : LANCZOS, m = 0;
    double norm = sqrt(dot(vector, vector, n));
    for (int k = 0; k < n; k++) basis[0][k] = vector[k] / norm;
    for (;; m++) {
        double *restrict next = basis[m + 1], before;
        memcpy(next, basis[m], n * sizeof(double));
        cholesky_solve(r, n, stride, next);
        diagonal[m] = dot(next, basis[m], n);
        do { /* Twice is enough: again only where most of the vector went away. */
            before = dot(next, next, n);
            for (int j = 0; j <= m; j++) {
                double along = dot(next, basis[j], n);
                for (int k = 0; k < n; k++) next[k] -= along * basis[j][k];
            }
            beside[m] = sqrt(dot(next, next, n));
        } while (beside[m] * beside[m] < 1e-2 * before && beside[m] > 1e-13);
        int last = m + 1 == steps || beside[m] < 1e-13;
        if (last || m % 2) {
            double lower = value;
            value = largest_of_tridiagonal(diagonal, beside, m + 1, lower);
            if (last || value - lower < EIGENVALUE_STEP * value) break;
        }
        for (int k = 0; k < n; k++) next[k] /= beside[m];
    }
    if (!wanted) return 1 / value;
    /* The eigenvector of the tridiagonal matrix, row by row. */
    double here = 1, back = 0;
    memset(vector, 0, n * sizeof(double));
    for (int j = 0; j <= m; j++) {
        for (int k = 0; k < n; k++) vector[k] += here * basis[j][k];
        double next = ((value - diagonal[j]) * here - (j ? beside[j - 1] * back : 0)) / beside[j];
        back = here;
        here = next;
    }
    return 1 / value;
}
