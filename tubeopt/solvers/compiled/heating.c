/* Heat in half a tube in time: the steps of physics/heat_functions.py, `step_function`, on a grid of any size.

   Before it stand the laws of one cell, `law_...`, that CasADi generates from the physics. What is written here is how
   cells and shells hang together: what leaves one enters the next, by conductances that Python hands over. Temperatures
   of the tube's cells stand first, then those of the shells, the innermost of all cells first. */
#include <string.h>

typedef const double *restrict In;
typedef double *restrict Out;

/* The coefficients of physics.heat.Volumes, and the properties. The last `covered` cells are in the mold. */
typedef struct {
    int cells, covered, shells, bare, size;
    const double *p, *heat, *resistance, *conduction, *to_clamp, *to_air, *radiating, *to_mold;
    const double *shell_heat, *radial, *outer, *axial, *grip_share, *cover_share;
} Rig;

/* What a step works with. Pivots are inverse; `ratio` tells what of a row is taken from the one that is eliminated
   after it. `wide` is the distance of rows in what stands by cells. */
typedef struct {
    double h;
    int wide;
    double *x, *capacity, *before, *gain, *first, *second, *between;
    double *leaving, *left, *right, *pivot, *ratio, *flow, *into;
    double *out_pivot, *out_ratio, *side_pivot, *side_ratio, *turned;
} Work;

/* Point it to its numbers. */
static void read_numbers(Rig *r, const double *p, const double *q) {
    int n = r->cells, c = r->covered, m = r->shells;
    const double **parts[] = {&r->heat,    &r->resistance, &r->conduction, &r->to_clamp, &r->to_air,     &r->radiating, &r->to_mold,
                              &r->shell_heat, &r->radial,  &r->outer,      &r->axial,    &r->grip_share, &r->cover_share};
    int lengths[] = {n, n, n - 1, n, n, n, c, c * m, c * (m - 1), c, (c - 1) * m, n, c};
    r->p = p;
    for (int k = 0; k < 13; q += lengths[k++]) *parts[k] = q;
}

/* --- rates ---------------------------------------------------------------------------------------------------------*/

/* half, mean, drive, current. */
static void load_of(const Rig *r, In tube, In lumped, double duty, double load[4]) {
    double half = 0;
    for (int i = 0; i < r->cells; i++) {
        double ohm;
        const double *in[] = {tube + i, r->resistance + i, r->p};
        double *out[] = {&ohm};
        law_ohm(in, out, 0, 0, 0);
        half += ohm;
    }
    const double *in[] = {&half, lumped, &duty, r->p};
    double *out[] = {load};
    law_load(in, out, 0, 0, 0);
}

/* What the tube's cells gain by themselves, and their capacities; what goes into the clamp and to the air in all. */
static void tube_gains(const Rig *r, In tube, double clamp, const double load[4], Out gain, Out capacity, Out leaving,
                       double *into_clamp, double *air) {
    double given = 0, off = 0;
    for (int i = 0; i < r->cells; i++) {
        double own, into, away, held, slope, T = tube[i];
        const double *in[] = {&T,           &clamp,           load,               r->heat + i, r->resistance + i, r->to_clamp + i,
                              r->to_air + i, r->radiating + i, r->grip_share + i, r->p};
        double *out[] = {&own, &into, &away, &held, &slope};
        law_cell(in, out, 0, 0, 0);
        gain[i] = own, capacity[i] = held, leaving[i] = slope;
        given += into, off += away;
    }
    *into_clamp = given;
    *air = off;
}

/* What passes along the tube is added to the gain; its slopes in the temperatures on the left and on the right. */
static void along_tube(const Rig *r, In tube, Out flow, Out left, Out right, Out gain) {
    int n = r->cells;
    flow[0] = flow[n] = 0;
    for (int i = 0; i < n - 1; i++) {
        double passes, by_left, by_right, T = tube[i], next = tube[i + 1];
        const double *in[] = {&T, &next, r->conduction + i, r->p};
        double *out[] = {&passes, &by_left, &by_right};
        law_link(in, out, 0, 0, 0);
        flow[i + 1] = passes, left[i] = by_left, right[i] = by_right;
    }
    for (int i = 0; i < n; i++) gain[i] += flow[i + 1] - flow[i];
}

/* What the tube gives to the innermost shells is taken from its gain. */
static void into_mold(const Rig *r, In x, Out into, Out gain) {
    const double *tube = x + r->bare, *innermost = x + r->cells;
    Out of_tube = gain + r->bare;
    for (int j = 0; j < r->covered; j++) {
        into[j] = r->to_mold[j] * (tube[j] - innermost[j]);
        of_tube[j] -= into[j];
    }
}

/* What shells gain, of the tube `into`. */
static void shell_gains(const Rig *r, In x, const double load[4], In into, Out flow, Out gain) {
    int c = r->covered, m = r->shells;
    double ambient = r->p[AMBIENT];
    const double *shells = x + r->cells;
    double *of_shells = gain + r->cells;
    for (int j = 0; j < c; j++) {
        double stray;
        const double *in[] = {load, r->cover_share + j, r->p};
        double *out[] = {&stray};
        law_stray(in, out, 0, 0, 0);
        of_shells[j] = into[j] + stray;
    }
    for (int k = 0; k < m; k++) {
        In here = shells + k * c, axial = r->axial + k * (c - 1);
        Out mine = of_shells + k * c;
        flow[0] = flow[c] = 0;
        for (int j = 0; j < c - 1; j++) flow[j + 1] = axial[j] * (here[j + 1] - here[j]);
        if (k + 1 == m) {
            for (int j = 0; j < c; j++) mine[j] += flow[j + 1] - flow[j] - r->outer[j] * (here[j] - ambient);
            continue;
        }
        In radial = r->radial + k * c, there = here + c;
        Out next = mine + c;
        for (int j = 0; j < c; j++) {
            double outward = radial[j] * (here[j] - there[j]);
            mine[j] += flow[j + 1] - flow[j] - outward;
            next[j] = outward;
        }
    }
}

/* Rates of the lumped state, where so much goes into the clamp and to the air. */
static void lump_rates(const Rig *r, In x, In lumped, const double load[4], double into_clamp, double air, double rate[LUMPED]) {
    const double *outermost = x + r->size - r->covered;
    for (int j = 0; j < r->covered; j++) air += r->outer[j] * (outermost[j] - r->p[AMBIENT]);
    const double *in[] = {lumped + CLAMP, &into_clamp, &air, load, lumped, r->p};
    double *out[] = {rate};
    law_lumps(in, out, 0, 0, 0);
}

/* --- the matrices of a stage ---------------------------------------------------------------------------------------*/

/* Of the shells, which depend on nothing but the step: outward, eliminated from the outermost inwards, and sideways. */
static void factor_shells(const Rig *r, Work *w, double h) {
    int c = r->covered, m = r->shells, wide = w->wide;
    double gh = GAMMA * h;
    w->h = h;
    memcpy(w->capacity + r->cells, r->shell_heat, (size_t)c * m * sizeof(double));
    for (int j = 0; j < c; j++)
        for (int k = m - 1; k >= 0; k--) {
            double inner = k ? r->radial[(k - 1) * c + j] : r->to_mold[j], outer = k + 1 < m ? r->radial[k * c + j] : 0;
            double pivot = r->shell_heat[k * c + j] + gh * (inner + outer);
            if (k + 1 < m) pivot += gh * outer * w->out_ratio[(k + 1) * c + j];
            w->out_pivot[k * c + j] = 1 / pivot;
            w->out_ratio[k * c + j] = -gh * inner / pivot;
        }
    memset(w->side_pivot, 0, 2 * (size_t)c * wide * sizeof(double)); /* and the ratios behind it */
    for (int j = 0; j < c; j++)
        for (int k = 0; k < m; k++) {
            double before = j ? r->axial[k * (c - 1) + j - 1] : 0, after = j + 1 < c ? r->axial[k * (c - 1) + j] : 0;
            double pivot = r->shell_heat[k * c + j] + gh * (before + after + (k + 1 == m ? r->outer[j] : 0));
            if (j) pivot += gh * before * w->side_ratio[(j - 1) * wide + k];
            w->side_pivot[j * wide + k] = 1 / pivot;
            w->side_ratio[j * wide + k] = -gh * after / pivot;
        }
}

/* Of the tube sideways, at its temperatures. */
static void factor_tube(const Rig *r, Work *w) {
    double gh = GAMMA * w->h;
    for (int i = 0; i < r->cells; i++) {
        double grows = (i + 1 < r->cells ? w->left[i] : 0) - (i ? w->right[i - 1] : 0);
        double pivot = w->capacity[i] + gh * (w->leaving[i] - grows);
        if (i) pivot += gh * w->right[i - 1] * w->ratio[i - 1];
        w->pivot[i] = 1 / pivot;
        w->ratio[i] = i + 1 < r->cells ? -gh * w->right[i] / pivot : 0;
    }
}

/* x <- (sideways)^-1 capacity (outward)^-1 x: a stage of the method. */
static void outward(const Rig *r, const Work *w, Out x) {
    int c = r->covered, m = r->shells;
    double gh = GAMMA * w->h;
    double *tube = x + r->bare, *shells = x + r->cells;
    for (int k = m - 1; k > 0; k--) {
        In ratio = w->out_ratio + k * c, from = shells + k * c;
        Out to = shells + (k - 1) * c;
        for (int j = 0; j < c; j++) to[j] -= ratio[j] * from[j];
    }
    for (int i = 0; i < r->bare; i++) x[i] /= w->capacity[i];
    for (int j = 0; j < c; j++) {
        double pivot = w->capacity[r->bare + j] + gh * r->to_mold[j] * (1 + w->out_ratio[j]);
        tube[j] = (tube[j] - w->out_ratio[j] * shells[j]) / pivot;
        shells[j] = shells[j] * w->out_pivot[j] - w->out_ratio[j] * tube[j];
    }
    for (int k = 1; k < m; k++) {
        In ratio = w->out_ratio + k * c, pivot = w->out_pivot + k * c, from = shells + (k - 1) * c;
        Out to = shells + k * c;
        for (int j = 0; j < c; j++) to[j] = to[j] * pivot[j] - ratio[j] * from[j];
    }
}

static void sideways(const Rig *r, const Work *w, Out x) {
    int n = r->cells, c = r->covered, m = r->shells, wide = w->wide;
    double *shells = x + n;
    Out turned = w->turned;
    for (int i = 1; i < n; i++) x[i] -= w->ratio[i - 1] * x[i - 1];
    x[n - 1] *= w->pivot[n - 1];
    for (int i = n - 2; i >= 0; i--) x[i] = x[i] * w->pivot[i] - w->ratio[i] * x[i + 1];
    for (int k = 0; k < m; k++)
        for (int j = 0; j < c; j++) turned[j * wide + k] = shells[k * c + j];
    for (int j = 1; j < c; j++) {
        In ratio = w->side_ratio + (j - 1) * wide, from = turned + (j - 1) * wide;
        Out to = turned + j * wide;
        for (int k = 0; k < wide; k++) to[k] -= ratio[k] * from[k];
    }
    for (int j = c - 1; j >= 0; j--) {
        In ratio = w->side_ratio + j * wide, pivot = w->side_pivot + j * wide, from = turned + (j + 1) * wide;
        Out to = turned + j * wide;
        for (int k = 0; k < wide; k++) to[k] = to[k] * pivot[k] - ratio[k] * from[k];
    }
    for (int k = 0; k < m; k++)
        for (int j = 0; j < c; j++) shells[k * c + j] = turned[j * wide + k];
}

static void stage(const Rig *r, const Work *w, Out x) {
    outward(r, w, x);
    for (int i = 0; i < r->size; i++) x[i] *= w->capacity[i];
    sideways(r, w, x);
}

/* --- the step ------------------------------------------------------------------------------------------------------*/

/* ROS2 over h, for which the shells are factored, at a duty. */
static void step(const Rig *r, Work *w, double duty, Out x, double lumped[LUMPED]) {
    double load[4], slow[LUMPED], later[LUMPED], faster[LUMPED], into_clamp, air, h = w->h;
    int n = r->cells, size = r->size;
    load_of(r, x, lumped, duty, load);
    tube_gains(r, x, lumped[CLAMP], load, w->first, w->capacity, w->leaving, &into_clamp, &air);
    along_tube(r, x, w->flow, w->left, w->right, w->first);
    into_mold(r, x, w->into, w->first);
    shell_gains(r, x, load, w->into, w->flow, w->first);
    lump_rates(r, x, lumped, load, into_clamp, air, slow);
    factor_tube(r, w);
    stage(r, w, w->first);
    for (int i = 0; i < size; i++) w->between[i] = x[i] + h * w->first[i];
    for (int k = 0; k < LUMPED; k++) later[k] = lumped[k] + h * slow[k];
    load_of(r, w->between, later, duty, load);
    tube_gains(r, w->between, later[CLAMP], load, w->second, w->before, w->leaving, &into_clamp, &air);
    along_tube(r, w->between, w->flow, w->left, w->right, w->second);
    into_mold(r, w->between, w->into, w->second);
    shell_gains(r, w->between, load, w->into, w->flow, w->second);
    for (int i = 0; i < n; i++) w->second[i] *= w->capacity[i] / w->before[i];
    for (int i = 0; i < size; i++) w->second[i] -= 2 * w->capacity[i] * w->first[i];
    stage(r, w, w->second);
    for (int i = 0; i < size; i++) x[i] += h * (1.5 * w->first[i] + 0.5 * w->second[i]);
    /* The stage in between overshoots what is stiff: the clamps would feel it. */
    load_of(r, x, later, duty, load);
    tube_gains(r, x, later[CLAMP], load, w->gain, w->before, w->leaving, &into_clamp, &air);
    lump_rates(r, x, later, load, into_clamp, air, faster);
    for (int k = 0; k < LUMPED; k++) lumped[k] += 0.5 * h * (slow[k] + faster[k]);
}

/* --- what Python calls ---------------------------------------------------------------------------------------------*/

/* Arrays in one piece of memory, whose first number is the step for which the shells are factored; where it ends. */
static double *lay_out(const Rig *r, Work *w, double *memory) {
    size_t size = r->size, n = r->cells + 1, shells = (size_t)r->covered * r->shells;
    w->h = memory[0];
    w->wide = (r->shells + 7) / 8 * 8;
    size_t turned = (size_t)r->covered * w->wide;
    double **parts[] = {&w->x,      &w->capacity, &w->first, &w->second, &w->between,   &w->before,    &w->gain,       &w->leaving,    &w->left, &w->right,
                        &w->pivot,  &w->ratio,    &w->flow,  &w->into,   &w->out_pivot, &w->out_ratio, &w->side_pivot, &w->side_ratio, &w->turned};
    size_t lengths[] = {size, size, size, size, size, n, n, n, n, n, n, n, n, n, shells, shells, turned, turned, turned + w->wide};
    memory++;
    for (int k = 0; k < 19; memory += lengths[k++]) *parts[k] = memory;
    return memory;
}

static Rig grid_of(long long n, long long covered, long long shells) {
    return (Rig){.cells = n, .covered = covered, .shells = shells, .bare = n - covered, .size = n + covered * shells};
}

/* How many numbers of memory a grid needs: of zeros but for the first, which is below 0. */
CASADI_SYMBOL_EXPORT long long workspace_size(long long n, long long covered, long long shells) {
    Rig r = grid_of(n, covered, shells);
    Work w;
    double start = 0;
    return lay_out(&r, &w, &start) - &start;
}

/* A member's temperatures from (n, 1 + shells) of all cells, and back; shells without a mold are those of `like`. */
static void read_cells(const Rig *r, In cells, Out x) {
    int m = r->shells;
    for (int i = 0; i < r->cells; i++) x[i] = cells[i * (1 + m)];
    for (int j = 0; j < r->covered; j++)
        for (int k = 0; k < m; k++) x[r->cells + k * r->covered + j] = cells[(r->bare + j) * (1 + m) + 1 + k];
}

static void write_cells(const Rig *r, In x, const double *like, double *cells) {
    int m = r->shells;
    if (cells != like) memcpy(cells, like, (size_t)r->bare * (1 + m) * sizeof(double));
    for (int i = 0; i < r->cells; i++) cells[i * (1 + m)] = x[i];
    for (int j = 0; j < r->covered; j++)
        for (int k = 0; k < m; k++) cells[(r->bare + j) * (1 + m) + 1 + k] = x[r->cells + k * r->covered + j];
}

/* Of `members` rigs, states after windows of `span` s, in so many equal steps each, at constant duties (windows, members).

   Properties `p` stand `apart_p` numbers apart, coefficients `q` `apart_q`: 0 where one is for all. place: (windows + 1)
   rows of `cells` (rows, members, n, 1 + shells) and `lumped` (rows, members, LUMPED) in which the states stand, the first
   of them given; shells of cells without a mold stay as they are there. `memory` keeps the factors of the last step, which
   is of use to one member whose numbers stay. */
CASADI_SYMBOL_EXPORT void march(long long n, long long covered, long long shells, long long members, long long windows,
                                long long apart_p, long long apart_q, const double *p, const double *q, const double *span,
                                const long long *steps, const double *duty, const long long *place, double *cells,
                                double *lumped, double *memory) {
    Rig r = grid_of(n, covered, shells);
    Work w;
    lay_out(&r, &w, memory);
    size_t own = (size_t)n * (1 + shells);
    for (long long b = 0; b < members; b++) {
        const double *start = cells + (place[0] * members + b) * own;
        double lump[LUMPED];
        read_numbers(&r, p + b * apart_p, q + b * apart_q);
        read_cells(&r, start, w.x);
        memcpy(lump, lumped + (place[0] * members + b) * LUMPED, sizeof lump);
        for (long long s = 0; s < windows; s++) {
            double h = span[s] / steps[s];
            if (h != w.h) factor_shells(&r, &w, h);
            for (long long k = 0; k < steps[s]; k++) step(&r, &w, duty[s * members + b], w.x, lump);
            write_cells(&r, w.x, start, cells + (place[s + 1] * members + b) * own);
            memcpy(lumped + (place[s + 1] * members + b) * LUMPED, lump, sizeof lump);
        }
        if (members > 1) w.h = -1;
    }
    memory[0] = w.h;
}

/* Of one rig in a state, the rates (n) of the tube's cells without and with full duty, and after them the current while the
   MOSFET conducts. */
CASADI_SYMBOL_EXPORT void spread(long long n, long long covered, long long shells, const double *p, const double *q,
                                 const double *cells, const double *lumped, double *out, double *memory) {
    Rig r = grid_of(n, covered, shells);
    Work w;
    double load[4], into_clamp, air;
    lay_out(&r, &w, memory);
    read_numbers(&r, p, q);
    read_cells(&r, cells, w.x);
    for (int full = 0; full < 2; full++) {
        Out rate = out + full * n;
        load_of(&r, w.x, lumped, full, load);
        tube_gains(&r, w.x, lumped[CLAMP], load, rate, w.before, w.leaving, &into_clamp, &air);
        along_tube(&r, w.x, w.flow, w.left, w.right, rate);
        into_mold(&r, w.x, w.into, rate);
        for (int i = 0; i < n; i++) rate[i] /= w.before[i];
    }
    out[2 * n] = load[3];
}
