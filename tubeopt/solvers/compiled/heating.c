/* Heat in half a tube in time: the steps of physics/heat_functions.py, `step_function`, on a grid of any size.

   Before it stand the laws of one cell, `law_...`, that CasADi generates from the physics. What is written here is how
   cells are connected. A field has a row of n numbers for the tube and one for each shell, outwards. Cells without a mold
   have shells, too, of capacity 1, which exchange no heat: so they stay as they are, and all rows are alike. */
#include <string.h>

typedef const double *restrict In;
typedef double *restrict Out;

/* Symmetric tridiagonal systems side by side, `rows` of `wide` numbers: their diagonals, and beside these what couples a
   row to the next one, 0 in the last. Factored: inverse pivots, and the part of a row that the next one loses. */
typedef struct {
    int rows, wide;
    double *diagonal, *beside, *inverse, *ratio;
} Lines;

/* A rig as heating.py hands it over, and what a step works with. The first numbers belong to cells of the tube, `conduction`
   to those before their next one; `outside` are conductances from a row to the next one, from the last to the air, and
   `beside` from a cell of a shell to the next one, where the mold conducts by a factor of 1; `outward` and `along` the same
   at the last temperatures given to `conduct`. */
typedef struct {
    int cells, rows, size;
    double gh; /* GAMMA times the step of which the matrices are */
    const double *p, *heat, *resistance, *to_clamp, *to_air, *radiating, *grip_share, *conduction, *cover_share, *wall;
    const double *outside, *beside;
    double *x, *capacity, *before, *first, *second, *between, *leaving, *left, *right, *flow, *turned;
    double *outward, *along, *factor;
    Lines outwards, sideways; /* of a stage, whose matrix is the product of both */
} Rig;

/* --- systems -------------------------------------------------------------------------------------------------------*/

static void factor(const Lines *l) {
    int wide = l->wide, size = l->rows * wide;
    In diagonal = l->diagonal, beside = l->beside;
    Out inverse = l->inverse, ratio = l->ratio;
    memcpy(inverse, diagonal, wide * sizeof(double));
    for (int k = 0; k < size; k += wide)
        for (int j = k; j < k + wide; j++) {
            inverse[j] = 1 / inverse[j];
            ratio[j] = beside[j] * inverse[j];
            inverse[j + wide] = diagonal[j + wide] - ratio[j] * beside[j]; /* behind the last row, of no meaning */
        }
}

/* x <- the solution for the right-hand sides x, behind which there is room for a row, too. */
static void solve_lines(const Lines *l, Out x) {
    int wide = l->wide, last = (l->rows - 1) * wide;
    In inverse = l->inverse, ratio = l->ratio;
    for (int k = 0; k < last; k += wide)
        for (int j = k; j < k + wide; j++) x[j + wide] -= ratio[j] * x[j];
    for (int k = last; k >= 0; k -= wide)
        for (int j = k; j < k + wide; j++) x[j] = x[j] * inverse[j] - ratio[j] * x[j + wide];
}

static void transpose(In from, int rows, int columns, Out to) {
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) to[c * rows + r] = from[r * columns + c];
}

/* Conductances of the mold at temperatures x, by the mean of the factors of two neighbours, at most `most` times the last
   ones. Not of the last row, to the air. */
static void conduct(Rig *r, In x, double most) {
    int n = r->cells, last = r->size - n;
    Out f = r->factor;
    In p = r->p;
    for (int i = n; i < r->size; i++) {
        double T = x[i], factor; /* with addresses that are not null, so that there is no branch */
        const double *in[] = {&T, p};
        double *out[] = {&factor};
        law_factor(in, out, 0, 0, 0);
        f[i] = factor;
    }
    for (int i = 0; i < n; i++) {
        const double *in[] = {f + n + i, r->outside + i, r->wall + i};
        double conductance, *out[] = {&conductance};
        law_gap(in, out, 0, 0, 0);
        r->outward[i] = smaller(conductance, most * r->outward[i]);
    }
    for (int i = n; i < last; i++)
        r->outward[i] = smaller(0.5 * r->outside[i] * (f[i] + f[i + n]), most * r->outward[i]);
    for (int i = n; i + 1 < r->size; i++)
        r->along[i] = smaller(0.5 * r->beside[i] * (f[i] + f[i + 1]), most * r->along[i]);
}

/* The matrices of the stages of steps over h, physics.heat.frozen_jacobian in its two directions, at the conductances of the
   mold, but for what depends on temperatures of the tube. What leaves to clamp and air stands in the second, which is exact where a cell has no shells. */
static void put_shells(Rig *r, double h) {
    int n = r->cells, rows = r->rows, last = r->size - n;
    Out diagonal = r->outwards.diagonal, beside = r->outwards.beside, own = r->between, coupled = r->first;
    r->gh = GAMMA * h;
    for (int i = 0; i < last; i++) beside[i] = -r->gh * r->outward[i];
    for (int i = n; i < r->size; i++) {
        diagonal[i] = r->capacity[i] - beside[i] - beside[i - n];
        coupled[i] = -r->gh * r->along[i];
        own[i] = r->capacity[i] - coupled[i] + r->gh * r->along[i - 1]; /* 0 from the last cell of a row */
    }
    for (int i = last; i < r->size; i++) own[i] += r->gh * r->outward[i];
    transpose(own, rows, n, r->sideways.diagonal);
    transpose(coupled, rows, n, r->sideways.beside);
}

/* What does depend on them, at those whose slopes are there. */
static void factor_stage(Rig *r) {
    int rows = r->rows;
    for (int i = 0; i < r->cells; i++) {
        double grows = r->left[i] - (i ? r->right[i - 1] : 0);
        r->outwards.diagonal[i] = r->capacity[i] - r->outwards.beside[i];
        r->sideways.diagonal[i * rows] = r->capacity[i] + r->gh * (r->leaving[i] - grows);
        r->sideways.beside[i * rows] = -r->gh * r->right[i];
    }
    factor(&r->outwards);
    factor(&r->sideways);
}

/* x <- (sideways)^-1 capacity (outwards)^-1 x */
static void stage(const Rig *r, Out x) {
    solve_lines(&r->outwards, x);
    for (int i = 0; i < r->size; i++) x[i] *= r->capacity[i];
    transpose(x, r->rows, r->cells, r->turned);
    solve_lines(&r->sideways, r->turned);
    transpose(r->turned, r->cells, r->rows, x);
}

/* --- rates ---------------------------------------------------------------------------------------------------------*/

/* What the cells gain by themselves, W, the capacities (n) of the tube, and rates of the lumped state; how fast what leaves
   grows goes to the rig. Returns the current while the MOSFET conducts. */
static double heat_cells(const Rig *r, In x, In lumped, double duty, Out gain, Out capacity, Out slow) {
    int n = r->cells, last = r->size - n;
    double half = 0, load[4], into_clamp = 0, air = 0;
    for (int i = 0; i < n; i++) {
        double ohm;
        const double *in[] = {x + i, r->resistance + i, r->p};
        double *out[] = {&ohm};
        law_ohm(in, out, 0, 0, 0);
        half += ohm;
    }
    const double *charged[] = {&half, lumped, &duty, r->p};
    double *fed[] = {load};
    law_load(charged, fed, 0, 0, 0);
    memset(gain, 0, r->size * sizeof(double));
    for (int i = 0; i < n; i++) {
        double into, away;
        const double *in[] = {x + i, lumped + CLAMP, load, r->heat + i, r->resistance + i, r->to_clamp + i,
                              r->to_air + i, r->radiating + i, r->grip_share + i, r->cover_share + i, r->p};
        double *out[] = {gain + i, gain + n + i, &into, &away, capacity + i, r->leaving + i};
        law_cell(in, out, 0, 0, 0);
        into_clamp += into;
        air += away + r->outward[last + i] * (x[last + i] - r->p[AMBIENT]);
    }
    const double *in[] = {lumped + CLAMP, &into_clamp, &air, load, lumped, r->p};
    double *out[] = {slow};
    law_lumps(in, out, 0, 0, 0);
    return load[3];
}

/* What passes between cells, and from the last row to a row of ambient temperature behind it, is added to the gain. */
static void exchange_heat(const Rig *r, In x, Out gain) {
    int n = r->cells;
    Out flow = r->flow;
    for (int i = 0; i + 1 < n; i++) {
        const double *in[] = {x + i, x + i + 1, r->conduction + i, r->p};
        double *out[] = {flow + i + 1, r->left + i, r->right + i};
        law_link(in, out, 0, 0, 0);
    }
    for (int k = 0; k < r->size; k += n) {
        for (int i = 0; i + 1 < n && k; i++) flow[i + 1] = r->along[k + i] * (x[k + i + 1] - x[k + i]);
        for (int i = 0; i < n; i++) {
            double outward = r->outward[k + i] * (x[k + i] - x[k + n + i]);
            gain[k + i] += flow[i + 1] - flow[i] - outward;
            gain[k + n + i] += outward;
        }
    }
}

/* ROS2 over h at a duty. */
static void step(Rig *r, double h, double duty, double lumped[LUMPED]) {
    double slow[LUMPED], later[LUMPED], faster[LUMPED];
    Out x = r->x, first = r->first, second = r->second, between = r->between;
    conduct(r, x, 1e9);
    put_shells(r, h);
    heat_cells(r, x, lumped, duty, first, r->capacity, slow);
    exchange_heat(r, x, first);
    factor_stage(r);
    stage(r, first);
    for (int i = 0; i < r->size; i++) between[i] = x[i] + h * first[i];
    for (int k = 0; k < LUMPED; k++) later[k] = lumped[k] + h * slow[k];
    heat_cells(r, between, later, duty, second, r->before, faster);
    conduct(r, between, GROWTH);
    exchange_heat(r, between, second);
    for (int i = 0; i < r->cells; i++) second[i] *= r->capacity[i] / r->before[i];
    for (int i = 0; i < r->size; i++) second[i] -= 2 * r->capacity[i] * first[i];
    stage(r, second);
    for (int i = 0; i < r->size; i++) x[i] += h * (1.5 * first[i] + 0.5 * second[i]);
    /* The stage in between overshoots what is stiff: the clamps would feel it. */
    heat_cells(r, x, later, duty, second, r->before, faster);
    for (int k = 0; k < LUMPED; k++) lumped[k] += 0.5 * h * (slow[k] + faster[k]);
}

/* --- what Python calls ---------------------------------------------------------------------------------------------*/

/* A rig on a grid whose arrays lie in one piece of memory, and where that ends. */
static double *lay_out(Rig *r, long long cells, long long rows, double *memory) {
    int n = (int)cells, m = (int)rows;
    *r = (Rig){.cells = n, .rows = m, .size = n * m};
    r->outwards = (Lines){.rows = m, .wide = n};
    r->sideways = (Lines){.rows = n, .wide = m};
    double **fields[] = {&r->x, &r->first, &r->second, &r->between, &r->capacity, &r->turned, &r->outwards.diagonal,
                         &r->outwards.beside, &r->outwards.inverse, &r->outwards.ratio, &r->sideways.diagonal,
                         &r->sideways.beside, &r->sideways.inverse, &r->sideways.ratio, &r->outward, &r->along, &r->factor};
    double **tube[] = {&r->before, &r->leaving, &r->left, &r->right, &r->flow};
    int room = r->size + (n > m ? n : m); /* a row more */
    for (size_t k = 0; k < sizeof fields / sizeof *fields; k++, memory += room) *fields[k] = memory;
    for (size_t k = 0; k < sizeof tube / sizeof *tube; k++, memory += n + 1) *tube[k] = memory;
    return memory;
}

/* How many numbers of memory a grid needs: of zeros. */
CASADI_SYMBOL_EXPORT long long workspace_size(long long n, long long rows) {
    Rig r;
    double start;
    return lay_out(&r, n, rows, &start) - &start;
}

/* The numbers of a member and its temperatures, (n, rows). */
static void begin(Rig *r, const double *p, const double *q, const double *cells) {
    const double **tube[] = {&r->heat,      &r->resistance, &r->to_clamp,   &r->to_air,
                             &r->radiating, &r->grip_share, &r->conduction, &r->cover_share, &r->wall};
    r->p = p;
    for (size_t k = 0; k < sizeof tube / sizeof *tube; k++, q += r->cells) *tube[k] = q;
    r->outside = q;
    r->beside = q + r->size;
    memcpy(r->outward, r->outside, r->size * sizeof(double));
    memcpy(r->along, r->beside, r->size * sizeof(double));
    memcpy(r->capacity, q + 2 * r->size, r->size * sizeof(double));
    transpose(cells, r->cells, r->rows, r->x);
    for (int i = 0; i < r->cells; i++) r->x[r->size + i] = r->between[r->size + i] = p[AMBIENT];
}

/* Of `members` rigs, states after windows of `span` s, in so many equal steps each, at constant duties (windows, members).

   Properties `p` stand `apart_p` numbers apart, coefficients `q` `apart_q`. place: (windows + 1) numbers of the states in
   `cells` (..., members, n, rows) and `lumped` (..., members, LUMPED), the first of which is given; shells of cells without
   a mold stay as they are there. */
CASADI_SYMBOL_EXPORT void march(long long n, long long rows, long long members, long long windows, long long apart_p,
                                long long apart_q, const double *p, const double *q, const double *span,
                                const long long *steps, const double *duty, const long long *place, double *cells,
                                double *lumped, double *memory) {
    Rig r;
    lay_out(&r, n, rows, memory);
    for (long long b = 0; b < members; b++) {
        double lump[LUMPED];
        begin(&r, p + b * apart_p, q + b * apart_q, cells + (place[0] * members + b) * r.size);
        memcpy(lump, lumped + (place[0] * members + b) * LUMPED, sizeof lump);
        for (long long s = 0; s < windows; s++) {
            double h = span[s] / steps[s];
            for (long long k = 0; k < steps[s]; k++) step(&r, h, duty[s * members + b], lump);
            transpose(r.x, r.rows, r.cells, cells + (place[s + 1] * members + b) * r.size);
            memcpy(lumped + (place[s + 1] * members + b) * LUMPED, lump, sizeof lump);
        }
    }
}

/* Of one rig in a state, the rates (n) of the tube's cells without and with full duty, and after them the current while the
   MOSFET conducts. */
CASADI_SYMBOL_EXPORT void spread(long long n, long long rows, const double *p, const double *q, const double *cells,
                                 const double *lumped, double *out, double *memory) {
    Rig r;
    double slow[LUMPED];
    lay_out(&r, n, rows, memory);
    begin(&r, p, q, cells);
    for (int full = 0; full < 2; full++) {
        Out rate = out + full * n;
        out[2 * n] = heat_cells(&r, r.x, lumped, full, r.first, r.before, slow);
        conduct(&r, r.x, 1e9);
        exchange_heat(&r, r.x, r.first);
        for (int i = 0; i < n; i++) rate[i] = r.first[i] / r.before[i];
    }
}
