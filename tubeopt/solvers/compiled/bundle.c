/* Equilibrium of tubes of fixed own length in a sheath: what block/transcription/bundle.py states, minimised by Newton's
   method.

   Before it stand the functions that CasADi generates: `bundle_energy` of an element, `carry` of a pose, and
   `coupling_rate`.

   Unknowns are the turns p and kappa at the points, the twist behind the plate, and the length h of the elements of each
   section; the own length of a tube up to a boundary is a constraint c = 0 with the multiplier lambda. Of the quadratic
   model kappa is eliminated point by point, then p element by element from the tip to the plate; rotations where an element
   begins, lengths and multipliers are left. What is not plain sailing is declined, and left to the general solver. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MOST_SECTIONS (2 * N)
#define MOST_POINTS (MOST_PIECES * CHECK_DEGREE)
#define MOST_SHAPE (MOST_PIECES * STEPS + 1)
#define MOST_UNKNOWNS (N + MOST_POINTS * N)
#define VALUES (2 * N + 3)               /* theta, p, kappa, h of `bundle_energy`; also theta, p, h, force on kappa */
#define SHARED (N + 2 * MOST_SECTIONS)   /* rotations where an element begins, h and lambda of all sections */
#define WIDTH ((N * CHECK_DEGREE + 3) / 4 * 4 + (SHARED + 3) / 4 * 4)

#define FIRST_LANCZOS 6 /* steps for the margin before eigenvalues near 1 are separated */
#define NEAR_ONE 1e-8   /* distance from 1 that separates them */
#define FARTHER 10      /* times the distance found, since a few steps find less than all of it */

enum { SOLVED = 0, DECLINED = 1 };

#include "four.c"
#include "linear.c"

typedef struct {
    int degree;
    const double *nodes, *weights, *matrix;  /* (K), (K), (K, K) */
    const double *basis, *once, *inside;     /* Lagrange basis at the shape points, integrated; at those of `carry` */
} Rule;

#define RULE_OF(k, degree) \
    {degree, RULE##k##_nodes, RULE##k##_weights, RULE##k##_matrix, RULE##k##_basis, RULE##k##_once, RULE##k##_inside}
static const Rule RULE[] = {RULE_OF(0, DEGREE), RULE_OF(1, CHECK_DEGREE)};

/* A place where tubes end or begin to curve, at this own arc length of one of them. */
typedef struct {
    double arc_length, tube, ends[N], begins[N];
} Boundary;

typedef struct {
    double kb[N], kt[N], moment[N], offset[N], angle[N], behind[N], lever[N][2], sheath, boundaries;
    Boundary boundary[MOST_SECTIONS];
} Tubes;

/* Sections in order, each up to its boundary, and their elements. */
typedef struct {
    const Tubes *tubes;
    const Rule *rule;
    int sections, pieces, points, order[MOST_SECTIONS], count[MOST_SECTIONS], held[MOST_SECTIONS];
    int section[MOST_PIECES], present[MOST_SECTIONS][N];
    double kb[MOST_SECTIONS][N], kt[MOST_SECTIONS][N], moment[MOST_SECTIONS][N];
    const double *lever[MOST_SECTIONS];  /* of the tube at the boundary */
} Layout;

/* An equilibrium close by: on `sections` up to `end`, with `pieces` elements each, at other `rotations`; translations have
   grown by `shift` since. */
typedef struct {
    double sections, end[MOST_SECTIONS], pieces[MOST_SECTIONS], rotations[N], twist[N], shift[N];
    double points[]; /* theta (N) of all points, then curvature (2) */
} Start;

typedef struct {
    double turn[MOST_POINTS][N], bend[MOST_POINTS][2], h[MOST_SECTIONS], twist[N]; /* unknowns */
    double theta[MOST_POINTS][N], length[MOST_POINTS][N], off[MOST_SECTIONS], energy;  /* what they make; off is c */
    double first[MOST_POINTS][VALUES], second[MOST_POINTS][VALUES * VALUES];
} State;

/* Of kappa at a point: inverse of its second derivative, and the mixed ones by theta, p, h and the force on it. */
typedef struct {
    double inverse[3], mixed[2][VALUES];
} Bending;

typedef struct {
    int rows, first[N];                             /* whitened turns, filled up; those of each tube, -1 without */
    double scale[N][CHECK_DEGREE];                  /* turns by whitened ones */
    double matrix[WIDTH * WIDTH];
} Piece;

typedef struct {
    Bending bending[MOST_POINTS];
    Piece piece[MOST_PIECES];
    double root[SHARED * SHARED];                   /* of what is left where the arm begins */
    int pivots[SHARED];
} Factors;

/* A gradient by the unknowns and by the multipliers. */
typedef struct {
    double value[MOST_POINTS][VALUES], twist[N], off[MOST_SECTIONS];
} Functional;

/* A change of the unknowns, and the multipliers. */
typedef struct {
    double turn[MOST_POINTS][N], theta[MOST_POINTS][N], bend[MOST_POINTS][2], h[MOST_SECTIONS], twist[N];
    double force[MOST_SECTIONS], local[MOST_PIECES][WIDTH];
} Step;

typedef struct {
    double margin, residual, theta_error, tip_error, energy, contraction, largest_change;
    long long iterations, pieces, sections;
    double section_start[MOST_SECTIONS], tube_end[N], tip_rotations[N];
    double point[MOST_POINTS], theta[MOST_POINTS][N], bent[MOST_POINTS][2];
    double arc_length[MOST_SHAPE], rotation[MOST_SHAPE][N], torsion[MOST_SHAPE][N];
    double curvature[MOST_SHAPE][2], position[MOST_SHAPE][3], frame[MOST_SHAPE][9];
} Answer;

typedef struct {
    Layout layout, check, other;
    State state, trial, finer;
    Factors factors;
    Functional by;
    Step step;
    double basis[LANCZOS + 1][MOST_UNKNOWNS], vector[MOST_UNKNOWNS], most; /* most: scale of `soften` */
    Answer arm;
} Workspace;

CASADI_SYMBOL_EXPORT size_t workspace_size(void) { return sizeof(Workspace); }
CASADI_SYMBOL_EXPORT size_t answer_size(void) { return sizeof(Answer); }

/* --- sections ---------------------------------------------------------------------------------------------------------- */

/* Tubes between the boundaries that are not `passed` and the plate. */
static void tubes_before(const Tubes *t, const int *passed, int *present, int *curved) {
    for (int i = 0; i < N; i++) {
        present[i] = 0;
        curved[i] = 1;
        for (int k = 0; k < (int)t->boundaries; k++) {
            if (passed[k]) continue;
            present[i] |= t->boundary[k].ends[i] > 0;
            curved[i] &= !(t->boundary[k].begins[i] > 0);
        }
        curved[i] &= present[i];
    }
}

/* Elements and stiffnesses of sections in their order. */
static int lay_out(Layout *l) {
    const Tubes *t = l->tubes;
    int passed[MOST_SECTIONS] = {0}, curved[N];
    l->pieces = 0;
    for (int j = 0; j < l->sections; j++) {
        tubes_before(t, passed, l->present[j], curved);
        for (int i = 0; i < N; i++) {
            l->kb[j][i] = l->present[j][i] ? t->kb[i] : 0;
            l->kt[j][i] = l->present[j][i] ? t->kt[i] : 0;
            l->moment[j][i] = curved[i] ? t->moment[i] : 0;
        }
        l->lever[j] = t->lever[(int)t->boundary[l->order[j]].tube];
        passed[l->order[j]] = 1;
        if (l->pieces + l->count[j] > MOST_PIECES) return 0;
        for (int e = 0; e < l->count[j]; e++) l->section[l->pieces++] = j;
    }
    l->points = l->pieces * l->rule->degree;
    return l->pieces > 0;
}

/* Untwisted tubes, marched from the plate: each section ends at the first boundary that its tubes reach. */
static int begin(const Tubes *t, const double *alpha, int halvings, Layout *l, State *state) {
    int passed[MOST_SECTIONS] = {0}, present[N], curved[N], x = 0;
    double done[N] = {0}, length[MOST_SECTIONS], bent[MOST_SECTIONS][2];
    l->tubes = t;
    l->rule = RULE;
    l->sections = 0;
    for (;;) {
        double total = t->sheath, u[2] = {0}, stretch[N], kb[N], moment[N], least = INFINITY, steepest = 0, need;
        const double *in[] = {kb, moment, t->kt};
        double *out[] = {&need};
        int next = -1, left = 0, j = l->sections;
        for (int k = 0; k < (int)t->boundaries && !left; k++)
            for (int i = 0; i < N; i++) left |= !passed[k] && t->boundary[k].ends[i] > 0;
        if (!left) break;
        tubes_before(t, passed, present, curved);
        for (int i = 0; i < N; i++) {
            kb[i] = present[i] ? t->kb[i] : 0;
            moment[i] = curved[i] ? t->moment[i] : 0;
            if (curved[i]) steepest = fmax(steepest, fabs(moment[i]) / kb[i]);
            total += kb[i];
            u[0] += moment[i] * cos(alpha[i]);
            u[1] += moment[i] * sin(alpha[i]);
        }
        for (int c = 0; c < 2; c++) bent[j][c] = u[c] / total;
        for (int i = 0; i < N; i++) stretch[i] = 1 + dot(t->lever[i], bent[j], 2);
        for (int k = 0; k < (int)t->boundaries; k++) {
            int i = (int)t->boundary[k].tube;
            double to_go = (t->boundary[k].arc_length - done[i]) / stretch[i];
            if (passed[k] || to_go >= least) continue;
            least = to_go;
            next = k;
        }
        if (next < 0) return 0;
        length[j] = fmax(least, 0);
        for (int i = 0; i < N; i++) done[i] += stretch[i] * length[j];
        l->held[j] = length[j] < 2 * HELD;
        coupling_rate(in, out, 0, 0, 0);
        need = length[j] * fmax(need / WAVES_PER_ELEMENT, steepest / BEND_PER_ELEMENT);
        l->count[j] = (int)fmax(1, ceil(need - 1e-9)) << halvings;
        state->h[j] = fmax(length[j], HELD) / l->count[j];
        l->order[j] = next;
        passed[next] = 1;
        l->sections++;
    }
    if (!l->sections || l->held[0] || !lay_out(l)) return 0;
    for (; x < l->points; x++) {
        int j = l->section[x / l->rule->degree];
        for (int c = 0; c < 2; c++) state->bend[x][c] = bent[j][c] * state->h[j];
    }
    memset(state->turn, 0, sizeof state->turn);
    memset(state->twist, 0, sizeof state->twist);
    return 1;
}

/* The boundaries at which the sections of an equilibrium close by end: of each, the one that its tube has just reached. */
static int recognise(const Start *from, Layout *l, const State *state) {
    const Tubes *t = l->tubes;
    int k = l->rule->degree, used[MOST_SECTIONS] = {0}, x = 0;
    double own[N] = {0};
    for (int j = 0; j < l->sections; j++) {
        double nearest = SAME_PLACE;
        for (int p = 0; p < k * l->count[j]; p++, x++)
            for (int i = 0; i < N; i++)
                own[i] += l->rule->weights[x % k] * (state->h[j] + dot(t->lever[i], state->bend[x], 2));
        l->order[j] = -1;
        for (int b = 0; b < (int)t->boundaries; b++) {
            int i = (int)t->boundary[b].tube;
            double off = fabs(t->boundary[b].arc_length - from->shift[i] - own[i]);
            /* Of boundaries that coincide, the first that is not yet passed. */
            if (used[b] || off >= nearest) continue;
            nearest = fmin(off, SAME_PLACE / 8);
            l->order[j] = b;
        }
        if (l->order[j] < 0) return 0;
        used[l->order[j]] = 1;
    }
    return 1;
}

/* The unknowns of an equilibrium close by. */
static int take_up(const Tubes *t, const Start *from, Layout *l, State *state) {
    const double *theta = from->points, *curvature;
    double before = 0, base[N];
    int e = 0, k;
    l->tubes = t;
    l->rule = RULE;
    k = l->rule->degree;
    l->sections = (int)from->sections;
    l->pieces = 0;
    if (l->sections != (int)t->boundaries) return 0;
    for (int j = 0; j < l->sections; j++) {
        double length = from->end[j] - before;
        before = from->end[j];
        l->count[j] = (int)from->pieces[j];
        l->held[j] = length < 2 * HELD;
        state->h[j] = (l->held[j] ? HELD : length) / l->count[j];
        l->pieces += l->count[j];
    }
    if (l->pieces > MOST_PIECES || l->held[0]) return 0;
    curvature = theta + l->pieces * k * N;
    for (int i = 0; i < N; i++) {
        state->twist[i] = from->twist[i];
        base[i] = from->rotations[i] + from->twist[i];
    }
    for (int j = 0; j < l->sections; j++)
        for (int c = 0; c < l->count[j]; c++, e++)
            for (int i = 0; i < N; i++) {
                double next = base[i];
                for (int a = 0; a < k; a++) {
                    double *turn = &state->turn[e * k + a][i];
                    *turn = 0;
                    for (int b = 0; b < k; b++) *turn += FROM_ROTATION[a * k + b] * (theta[(e * k + b) * N + i] - base[i]);
                    next += l->rule->weights[a] * *turn;
                    if (i < 2) state->bend[e * k + a][i] = state->h[j] * curvature[2 * (e * k + a) + i];
                }
                base[i] = next;
            }
    return recognise(from, l, state) && lay_out(l);
}

/* The largest change of a twist from that of an equilibrium close by, rad. */
static double twisted_since(const Layout *l, const double *alpha, const Start *from, const State *state) {
    double out = 0;
    for (int x = 0; x < l->points; x++)
        for (int i = 0; i < N; i++)
            if (l->present[l->section[x / l->rule->degree]][i])
                out = fmax(out, fabs(state->theta[x][i] - alpha[i] - from->points[x * N + i] + from->rotations[i]));
    return out;
}

/* --- energy ------------------------------------------------------------------------------------------------------------ */

/* Energy, gradient and second derivatives; 0 where an element or a tube in it has no length. */
static int evaluate(const Layout *l, const double *alpha, State *state) {
    const Tubes *t = l->tubes;
    int k = l->rule->degree;
    double base[N], own[N] = {0}, whole = 0;
    state->energy = 0;
    for (int i = 0; i < N; i++) {
        base[i] = alpha[i] + state->twist[i];
        if (t->behind[i] > 0) state->energy += t->kt[i] * state->twist[i] * state->twist[i] / (2 * t->behind[i]);
    }
    for (int e = 0; e < l->pieces; e++) {
        int j = l->section[e];
        double h = state->h[j], next[N];
        if (!(h > 0)) return 0;
        memcpy(next, base, sizeof next);
        whole += h;
        for (int a = 0; a < k; a++) {
            int x = e * k + a;
            double v[VALUES], energy, b = l->rule->weights[a];
            for (int i = 0; i < N; i++) {
                double turned = base[i];
                for (int c = 0; c < k; c++) turned += l->rule->matrix[a * k + c] * state->turn[e * k + c][i];
                v[i] = state->theta[x][i] = turned;
                v[N + i] = state->turn[x][i];
                next[i] += b * state->turn[x][i];
            }
            for (int c = 0; c < 2; c++) v[2 * N + c] = state->bend[x][c];
            v[2 * N + 2] = h;
            const double *in[] = {v, l->kb[j], l->kt[j], l->moment[j], t->offset, t->angle, &t->sheath};
            double *out[] = {&energy, state->first[x], state->second[x], state->length[x]};
            bundle_energy(in, out, 0, 0, 0);
            for (int i = 0; i < N; i++) {
                if (l->present[j][i] && !(state->length[x][i] > 0)) return 0;
                own[i] += b * dot(t->lever[i], state->bend[x], 2);
            }
            state->energy += b * energy;
        }
        memcpy(base, next, sizeof base);
        if (e + 1 == l->pieces || l->section[e + 1] != j) {
            const Boundary *at = &t->boundary[l->order[j]];
            state->off[j] = whole + own[(int)at->tube] - at->arc_length;
        }
    }
    return isfinite(state->energy);
}

/* --- quadratic model --------------------------------------------------------------------------------------------------- */

/* Second derivatives `local` by theta, p, h and the force on kappa, with kappa eliminated. */
static void eliminate_bend(const State *state, int x, double b, Bending *out, double (*local)[VALUES]) {
    const double *second = state->second[x];
    double pulled[2][VALUES];
    for (int c = 0; c < 2; c++) {
        const double *row = second + (2 * N + c) * VALUES;
        for (int r = 0; r < 2 * N; r++) out->mixed[c][r] = b * row[r];
        out->mixed[c][2 * N] = b * row[2 * N + 2];
        for (int d = 0; d < 2; d++) out->mixed[c][2 * N + 1 + d] = b * (c == d);
    }
    double xx = b * second[2 * N * VALUES + 2 * N], xy = b * second[2 * N * VALUES + 2 * N + 1];
    double yy = b * second[(2 * N + 1) * VALUES + 2 * N + 1], det = xx * yy - xy * xy;
    out->inverse[0] = yy / det;
    out->inverse[1] = -xy / det;
    out->inverse[2] = xx / det;
    for (int r = 0; r < VALUES; r++)
        for (int c = 0; c < 2; c++)
            pulled[c][r] = out->inverse[c] * out->mixed[0][r] + out->inverse[c + 1] * out->mixed[1][r];
    for (int r = 0; r < VALUES; r++)
        for (int q = 0; q < VALUES; q++) {
            int known = r <= 2 * N && q <= 2 * N;
            local[r][q] = -out->mixed[0][r] * pulled[0][q] - out->mixed[1][r] * pulled[1][q];
            if (known) local[r][q] += b * second[(r == 2 * N ? r + 2 : r) * VALUES + (q == 2 * N ? q + 2 : q)];
        }
}

/* Of a row or column by theta, h and the force on kappa: what it adds to one by the shared unknowns. */
static void share(const Layout *l, int j, const double *from, double *to) {
    int m = l->sections;
    for (int i = 0; i < N; i++) to[i] += from[i];
    to[N + j] += from[N];
    for (int k = j; k < m; k++) to[N + m + k] += dot(l->lever[k], from + N + 1, 2);
}

/* The matrix of an element, before what lies ahead of it. */
static void put_element(const Layout *l, const State *state, int e, Factors *f) {
    Piece *p = &f->piece[e];
    int k = l->rule->degree, j = l->section[e], m = l->sections, rows = 0, size = N + 3;
    const double *A = l->rule->matrix;
    double local[CHECK_DEGREE][VALUES][VALUES], sum[N + 3][N + 3] = {{0}}, spread[N + 3][SHARED] = {{0}};
    for (int a = 0; a < k; a++)
        eliminate_bend(state, e * k + a, l->rule->weights[a], &f->bending[e * k + a], local[a]);
    for (int i = 0; i < N; i++) {
        p->first[i] = l->present[j][i] ? rows : -1;
        rows += l->present[j][i] ? k : 0;
        for (int b = 0; b < k && l->present[j][i]; b++)
            p->scale[i][b] = sqrt(state->h[j] / (l->rule->weights[b] * l->tubes->kt[i]));
    }
    p->rows = filled_up(rows);
    int whole = p->rows + filled_up(N + 2 * m);
    for (int r = 0; r < whole; r++) {
        memset(p->matrix + r * WIDTH, 0, whole * sizeof(double));
        if (r >= rows && r < p->rows) p->matrix[r * WIDTH + r] = 1;
    }
    for (int i = 0; i < N; i++) {
        if (p->first[i] < 0) continue;
        for (int b = 0; b < k; b++) {
            double *row = p->matrix + (p->first[i] + b) * WIDTH, left[N + 3] = {0}, scale = p->scale[i][b];
            for (int c = 0; c < size; c++) {
                int q = c < N ? c : c + N;
                for (int a = 0; a < k; a++) left[c] += A[a * k + b] * local[a][i][q];
                left[c] = scale * (left[c] + local[b][N + i][q]);
            }
            share(l, j, left, row + p->rows);
            for (int o = i; o < N; o++) {
                if (p->first[o] < 0) continue;
                for (int c = 0; c < k; c++) {
                    double both = local[b][N + i][o] * A[b * k + c] + A[c * k + b] * local[c][i][N + o];
                    for (int a = 0; a < k; a++) both += A[a * k + b] * local[a][i][o] * A[a * k + c];
                    if (b == c) both += local[b][N + i][N + o];
                    row[p->first[o] + c] = scale * p->scale[o][c] * both;
                }
            }
        }
    }
    for (int r = 0; r < size; r++)
        for (int q = 0; q < size; q++)
            for (int a = 0; a < k; a++) sum[r][q] += local[a][r < N ? r : r + N][q < N ? q : q + N];
    for (int r = 0; r < size; r++) share(l, j, sum[r], spread[r]);
    for (int q = 0; q < N + 2 * m; q++) {
        double column[N + 3], out[SHARED] = {0};
        for (int r = 0; r < size; r++) column[r] = spread[r][q];
        share(l, j, column, out);
        for (int r = 0; r <= q; r++) p->matrix[(p->rows + r) * WIDTH + p->rows + q] = out[r];
    }
    for (int q = j; q < m; q++) p->matrix[(p->rows + N + j) * WIDTH + p->rows + N + m + q] += 1;
}

/* What lies ahead of an element, a form of the shared unknowns where it ends. */
static void add_ahead(const Layout *l, Piece *p, const double *ahead, int shared) {
    int k = l->rule->degree;
    for (int i = 0; i < N; i++) {
        if (p->first[i] < 0) continue;
        for (int b = 0; b < k; b++) {
            double *row = p->matrix + (p->first[i] + b) * WIDTH, scale = l->rule->weights[b] * p->scale[i][b];
            for (int q = 0; q < shared; q++) row[p->rows + q] += scale * ahead[i * SHARED + q];
            for (int o = i; o < N; o++)
                for (int c = 0; c < k && p->first[o] >= 0; c++)
                    row[p->first[o] + c] += scale * ahead[i * SHARED + o] * l->rule->weights[c] * p->scale[o][c];
        }
    }
    for (int r = 0; r < shared; r++)
        for (int q = r; q < shared; q++) p->matrix[(p->rows + r) * WIDTH + p->rows + q] += ahead[r * SHARED + q];
}

/* What is eliminated by a pivot of one or two rows, in place. */
static void take_out(double *a, int n, int r, int s, double rr, double rs, double ss) {
    for (int i = 0; i < n; i++) {
        if (i == r || i == s) continue;
        double x = a[i * SHARED + r], y = a[i * SHARED + s], by_r = rr * x + rs * y, by_s = rs * x + ss * y;
        for (int k = 0; k < n; k++)
            if (k != r && k != s) a[i * SHARED + k] -= by_r * a[r * SHARED + k] + by_s * a[s * SHARED + k];
    }
    for (int i = 0; i < n; i++) a[i * SHARED + r] = a[i * SHARED + s] = 0;
}

/* 1 if the second variation at constant own lengths is positive definite. Then rotations give positive pivots, and each
   length with its multiplier one pivot of either sign. */
static int is_minimum(const Layout *l, const double *matrix) {
    const Tubes *t = l->tubes;
    int m = l->sections, n = N + 2 * m;
    double a[SHARED * SHARED];
    memcpy(a, matrix, sizeof a);
    for (int i = 0; i < N; i++) {
        double pivot = a[i * SHARED + i];
        if (!(t->behind[i] > 0)) continue;
        if (!(pivot > 1e-13 * t->kt[i] / t->behind[i])) return 0;
        take_out(a, n, i, i, 1 / pivot, 0, 0);
    }
    for (int j = 0; j < m; j++) {
        int r = N + j, s = N + m + j;
        double rr = a[r * SHARED + r], rs = a[r * SHARED + s], ss = a[s * SHARED + s], det = rr * ss - rs * rs;
        if (l->held[j]) {
            if (!(ss < 0)) return 0;
            take_out(a, n, s, s, 1 / ss, 0, 0);
        } else {
            if (!(det < -1e-13 * rs * rs)) return 0;
            take_out(a, n, r, s, ss / det, -rs / det, rr / det);
        }
    }
    return 1;
}

/* Factors of the second variation plus shift times its torsional part without coupling; 0 unless it is positive definite where own
   lengths are constant. */
static int factorise(const Layout *l, const State *state, double shift, Factors *f) {
    int m = l->sections, shared = N + 2 * m;
    memset(f->root, 0, sizeof f->root);
    for (int e = l->pieces - 1; e >= 0; e--) {
        Piece *p = &f->piece[e];
        put_element(l, state, e, f);
        for (int i = 0; i < N && shift; i++)
            for (int b = 0; b < l->rule->degree && p->first[i] >= 0; b++) {
                int r = p->first[i] + b;
                p->matrix[r * WIDTH + r] += shift * state->h[l->section[e]] / state->length[e * l->rule->degree + b][i];
            }
        if (e + 1 < l->pieces) add_ahead(l, p, f->root, shared);
        if (!eliminate(p->matrix, p->rows, p->rows + filled_up(shared), WIDTH)) return 0;
        for (int r = 0; r < shared; r++)
            for (int q = r; q < shared; q++)
                f->root[r * SHARED + q] = f->root[q * SHARED + r] = p->matrix[(p->rows + r) * WIDTH + p->rows + q];
    }
    for (int i = 0; i < N; i++)
        if (l->tubes->behind[i] > 0) f->root[i * SHARED + i] += (1 + shift) * l->tubes->kt[i] / l->tubes->behind[i];
    for (int r = 0; r < N + m; r++) {
        if (r < N ? l->tubes->behind[r] > 0 : !l->held[r - N]) continue;
        for (int q = 0; q < shared; q++) f->root[r * SHARED + q] = f->root[q * SHARED + r] = r == q;
    }
    return is_minimum(l, f->root) && lu(f->root, shared, SHARED, f->pivots);
}

/* Newton's equations: minus the inverse of the second variation times a gradient, and the multipliers. */
static void solve_step(const Layout *l, const Factors *f, const Functional *by, Step *step) {
    int k = l->rule->degree, m = l->sections, shared = N + 2 * m;
    const double *A = l->rule->matrix, *weights = l->rule->weights;
    double ahead[SHARED] = {0}, here[N];
    for (int e = l->pieces - 1; e >= 0; e--) {
        const Piece *p = &f->piece[e];
        double *x = step->local[e], pull[CHECK_DEGREE][VALUES], sum[N + 3] = {0};
        int whole = p->rows + filled_up(shared);
        memset(x, 0, whole * sizeof(double));
        for (int a = 0; a < k; a++) {
            const Bending *bending = &f->bending[e * k + a];
            const double *value = by->value[e * k + a], *inverse = bending->inverse, *bend = value + 2 * N;
            double bent[2] = {inverse[0] * bend[0] + inverse[1] * bend[1], inverse[1] * bend[0] + inverse[2] * bend[1]};
            for (int r = 0; r < VALUES; r++) {
                pull[a][r] = r < 2 * N ? value[r] : r == 2 * N ? value[2 * N + 2] : 0;
                pull[a][r] -= bending->mixed[0][r] * bent[0] + bending->mixed[1][r] * bent[1];
            }
            for (int i = 0; i < N + 3; i++) sum[i] += pull[a][i < N ? i : i + N];
        }
        for (int i = 0; i < N; i++)
            for (int b = 0; b < k && p->first[i] >= 0; b++) {
                double total = pull[b][N + i] + weights[b] * ahead[i];
                for (int a = 0; a < k; a++) total += A[a * k + b] * pull[a][i];
                x[p->first[i] + b] = p->scale[i][b] * total;
            }
        memcpy(x + p->rows, ahead, shared * sizeof(double));
        share(l, l->section[e], sum, x + p->rows);
        eliminate_forwards(p->matrix, p->rows, whole, WIDTH, x);
        memcpy(ahead, x + p->rows, shared * sizeof(double));
    }
    for (int i = 0; i < N; i++) ahead[i] = l->tubes->behind[i] > 0 ? -(ahead[i] + by->twist[i]) : 0;
    for (int j = 0; j < m; j++) {
        ahead[N + j] = l->held[j] ? 0 : -ahead[N + j];
        ahead[N + m + j] = -(ahead[N + m + j] + by->off[j]);
    }
    lu_solve(f->root, shared, SHARED, f->pivots, ahead);
    memcpy(here, ahead, sizeof here);
    memcpy(step->twist, ahead, sizeof step->twist);
    memcpy(step->h, ahead + N, m * sizeof(double));
    memcpy(step->force, ahead + N + m, m * sizeof(double));
    for (int e = 0; e < l->pieces; e++) {
        const Piece *p = &f->piece[e];
        int j = l->section[e], whole = p->rows + filled_up(shared);
        double *x = step->local[e], next[N], force[2] = {0};
        for (int r = 0; r < p->rows; r++) x[r] = -x[r];
        memset(x + p->rows, 0, (whole - p->rows) * sizeof(double));
        memcpy(x + p->rows, here, sizeof here);
        memcpy(x + p->rows + N, ahead + N, 2 * m * sizeof(double));
        eliminate_backwards(p->matrix, p->rows, whole, WIDTH, x);
        for (int q = j; q < m; q++)
            for (int c = 0; c < 2; c++) force[c] += step->force[q] * l->lever[q][c];
        memcpy(next, here, sizeof next);
        for (int i = 0; i < N; i++)
            for (int a = 0; a < k; a++) {
                step->turn[e * k + a][i] = p->first[i] < 0 ? 0 : p->scale[i][a] * x[p->first[i] + a];
                next[i] += weights[a] * step->turn[e * k + a][i];
            }
        for (int a = 0; a < k; a++) {
            int y = e * k + a;
            const Bending *bending = &f->bending[y];
            double to[2];
            for (int i = 0; i < N; i++) {
                step->theta[y][i] = here[i];
                for (int b = 0; b < k; b++) step->theta[y][i] += A[a * k + b] * step->turn[e * k + b][i];
            }
            for (int c = 0; c < 2; c++)
                to[c] = by->value[y][2 * N + c] + dot(bending->mixed[c], step->theta[y], N) +
                        dot(bending->mixed[c] + N, step->turn[y], N) + bending->mixed[c][2 * N] * step->h[j] +
                        weights[a] * force[c];
            for (int c = 0; c < 2; c++)
                step->bend[y][c] = -(bending->inverse[c] * to[0] + bending->inverse[c + 1] * to[1]);
        }
        memcpy(here, next, sizeof here);
    }
}

/* --- Newton's method --------------------------------------------------------------------------------------------------- */

static void gradient_of(const Layout *l, const State *state, Functional *by) {
    const Tubes *t = l->tubes;
    for (int x = 0; x < l->points; x++)
        for (int v = 0; v < VALUES; v++) by->value[x][v] = l->rule->weights[x % l->rule->degree] * state->first[x][v];
    for (int i = 0; i < N; i++) by->twist[i] = t->behind[i] > 0 ? t->kt[i] * state->twist[i] / t->behind[i] : 0;
    memcpy(by->off, state->off, sizeof by->off);
}

/* Slope of the energy along a step. */
static double slope_of(const Layout *l, const Functional *by, const Step *step) {
    double out = dot(by->twist, step->twist, N);
    for (int x = 0; x < l->points; x++)
        out += dot(by->value[x], step->theta[x], N) + dot(by->value[x] + N, step->turn[x], N) +
               dot(by->value[x] + 2 * N, step->bend[x], 2) +
               by->value[x][2 * N + 2] * step->h[l->section[x / l->rule->degree]];
    return out;
}

/* The largest rotation of a tube or of the arm by a step, rad; held sections count as if they were as long as FELT. */
static double size_of(const Layout *l, const Step *step) {
    int k = l->rule->degree;
    double out = 0, arm[2] = {0};
    for (int x = 0; x < l->points; x++) {
        if (l->held[l->section[x / k]])
            out = fmax(out, FELT / HELD * fmax(largest(step->turn[x], N), largest(step->bend[x], 2)));
        out = fmax(out, fmax(largest(step->theta[x], N), largest(step->turn[x], N)));
        for (int c = 0; c < 2; c++) arm[c] += l->rule->weights[x % k] * step->bend[x][c];
        out = fmax(out, largest(arm, 2));
    }
    return out;
}

/* The fraction of a step that leaves all lengths positive; 0 where it closes a section, which is left in `closed`. */
static double most_of(const Layout *l, const State *state, const Step *step, int *closed) {
    double out = INFINITY;
    for (int j = 0; j < l->sections; j++) {
        double h = state->h[j], change = step->h[j];
        if (l->held[j] || change >= 0) continue;
        if (h < CLOSING && h + change <= fmax(VANISHING, 1e-3 * h)) {
            *closed = j;
            return 0;
        }
        out = fmin(out, -h / change);
    }
    for (int x = 0; x < l->points; x++) {
        int j = l->section[x / l->rule->degree];
        for (int i = 0; i < N; i++) {
            double change = step->h[j] + dot(l->tubes->lever[i], step->bend[x], 2);
            if (l->present[j][i] && change < 0) out = fmin(out, -state->length[x][i] / change);
        }
    }
    return out > 1 ? 1 : TO_BOUNDARY * out;
}

static void take_step(const Layout *l, const State *from, const Step *step, double scale, State *to) {
    for (int x = 0; x < l->points; x++) {
        for (int i = 0; i < N; i++) to->turn[x][i] = from->turn[x][i] + scale * step->turn[x][i];
        for (int c = 0; c < 2; c++) to->bend[x][c] = from->bend[x][c] + scale * step->bend[x][c];
    }
    for (int j = 0; j < l->sections; j++) to->h[j] = from->h[j] + scale * step->h[j];
    for (int i = 0; i < N; i++) to->twist[i] = from->twist[i] + scale * step->twist[i];
}

/* 1 if a step is so small that the next one may have the same factors. Turns in a section are in proportion to its length:
   factors of a shorter section would leave them as they are, and the steps would seem to converge. */
static int is_small(const Layout *l, const State *state, const Step *step) {
    for (int j = 0; j < l->sections; j++)
        if (!l->held[j] && fabs(step->h[j]) > 0.1 * fmin(state->h[j], state->h[j] + step->h[j])) return 0;
    return size_of(l, step) <= CHORD_STEP;
}

/* A minimum by Newton steps from w->state, shortened until the energy falls, or `whole` ones from a state close by; the
   factors of the last steps stay. Declined where a step closes a section, which is left in `closed`. */
static int minimise(const Layout *l, const double *alpha, int whole, Workspace *w, Answer *out, int *closed) {
    State *state = &w->state, *trial = &w->trial;
    double last = INFINITY, shift = 0;
    int fresh = 1, keeps = 1; /* factors are of this step; they may serve for the next one too */
    *closed = 0;
    if (!evaluate(l, alpha, state)) return DECLINED;
    for (int k = 0; k < MOST_ITERATIONS; k++) {
        out->iterations++;
        if (fresh)
            for (shift = 0; !factorise(l, state, shift, &w->factors); shift = shift ? 4 * shift : 0.1)
                if (whole || shift > 1e6) return DECLINED;
        gradient_of(l, state, &w->by);
        solve_step(l, &w->factors, &w->by, &w->step);
        double size = size_of(l, &w->step), scale;
        if (!fresh && size > last / 4 && size > 10 * ROUND_OFF) {
            fresh = 1;
            keeps = 0;
            last = INFINITY;
            continue;
        }
        scale = most_of(l, state, &w->step, closed);
        int apart = largest(state->off, l->sections) > SAME_PLACE; /* from an exchange, or a start at other translations */
        if (!isfinite(size) || !(scale > 0)) return DECLINED;
        if (whole && (scale < 1 || (size > LAST_STEP && size > LARGEST_RATIO * last))) return DECLINED;
        scale = fmin(scale, size > LONGEST_STEP ? LONGEST_STEP / size : 1);
        double slope = slope_of(l, &w->by, &w->step);
        for (int half = 0;; half++, scale /= 2) {
            take_step(l, state, &w->step, scale, trial);
            int valid = evaluate(l, alpha, trial);
            if ((whole || apart || size <= CHORD_STEP) && valid) break; /* energies of small steps differ by rounding */
            if (valid && trial->energy <= state->energy + 1e-4 * scale * slope + 1e-13 * fabs(state->energy)) break;
            if (whole || half == 40) return DECLINED;
        }
        fresh = !keeps || shift > 0 || !is_small(l, state, &w->step);
        memcpy(state, trial, sizeof *state);
        out->residual = size;
        if (size > LAST_STEP) out->contraction = fmax(out->contraction, size / last);
        if (size <= ROUND_OFF || (size <= LAST_STEP && size > last / 4))
            return size <= 1e-3 * LAST_STEP && !shift ? SOLVED : DECLINED;
        last = size;
    }
    return DECLINED;
}

/* The section before boundary j in which a step ended: its boundaries change places or, where they did already, stay
   together. 0 where that cannot be. */
static int exchange(Layout *l, State *state, int j, int (*exchanged)[MOST_SECTIONS]) {
    int k = l->rule->degree, a = l->order[j], b = l->order[j - 1], x = 0;
    if (l->held[j - 1] || l->held[j]) return 0;
    l->held[j] = exchanged[a][b];
    exchanged[a][b] = exchanged[b][a] = 1;
    l->order[j - 1] = a;
    l->order[j] = b;
    if (!lay_out(l)) return 0;
    while (l->section[x / k] < j) x++;
    for (int before = x - 1; x < l->points && l->section[x / k] == j; x++) {
        double shorter = l->held[j] ? HELD / state->h[j - 1] : 1;
        const double *turn = state->turn[l->held[j] ? before : x], *bend = state->bend[l->held[j] ? before : x];
        for (int i = 0; i < N; i++) state->turn[x][i] = l->present[j][i] ? shorter * turn[i] : 0;
        for (int c = 0; c < 2; c++) state->bend[x][c] = shorter * bend[c];
    }
    if (l->held[j]) state->h[j] = HELD;
    return 1;
}

/* Derivative of the energy by the length of a held section, N: negative where it would grow. */
static double holding_force(const Layout *l, const Workspace *w, int j) {
    int k = l->rule->degree;
    double out = 0;
    for (int x = 0; x < l->points; x++)
        if (l->section[x / k] == j) out += l->rule->weights[x % k] * w->state.first[x][2 * N + 2];
    for (int q = j; q < l->sections; q++) out += l->count[j] * w->step.force[q];
    return out;
}

/* A held section is free from now on, and long enough to grow. */
static void set_free(Layout *l, State *state, int j, int (*freed)[MOST_SECTIONS]) {
    int k = l->rule->degree, a = l->order[j], b = l->order[j - 1];
    freed[a][b] = freed[b][a] = 1;
    l->held[j] = 0;
    state->h[j] = VANISHING;
    for (int x = 0; x < l->points; x++) {
        if (l->section[x / k] != j) continue;
        for (int i = 0; i < N; i++) state->turn[x][i] *= VANISHING / HELD;
        for (int c = 0; c < 2; c++) state->bend[x][c] *= VANISHING / HELD;
    }
}

enum { STAYS, GROWS, UNKNOWN };

/* Whether held sections would grow, in the order of their boundaries or in the other one: the first that does is then free,
   once in a solve. */
static int grown(Layout *l, const double *alpha, Workspace *w, int (*freed)[MOST_SECTIONS]) {
    int none = 1, closed;
    for (int j = 0; j < l->sections; j++) none &= !l->held[j];
    if (none) return STAYS;
    memcpy(&w->finer, &w->state, sizeof w->state);
    for (int j = 1; j < l->sections; j++) {
        if (!l->held[j] || freed[l->order[j]][l->order[j - 1]]) continue;
        if (holding_force(l, w, j) < 0) {
            set_free(l, &w->state, j, freed);
            return GROWS;
        }
    }
    for (int j = 1; j < l->sections; j++) {
        if (!l->held[j] || freed[l->order[j]][l->order[j - 1]]) continue;
        Answer *other = &w->arm;
        memcpy(&w->other, l, sizeof *l);
        w->other.order[j] = l->order[j - 1];
        w->other.order[j - 1] = l->order[j];
        memcpy(&w->state, &w->finer, sizeof w->state);
        if (!lay_out(&w->other) || minimise(&w->other, alpha, 1, w, other, &closed)) return UNKNOWN;
        if (holding_force(&w->other, w, j) < 0) {
            memcpy(l, &w->other, sizeof *l);
            set_free(l, &w->state, j, freed);
            return GROWS;
        }
    }
    memcpy(&w->state, &w->finer, sizeof w->state);
    /* Of three boundaries together any two may go first, and not all of these were tried. */
    for (int j = 1; j < l->sections; j++)
        if (l->held[j] && l->held[j - 1]) return UNKNOWN;
    return STAYS;
}

/* --- answers ----------------------------------------------------------------------------------------------------------- */

/* x <- most D S^-1 D x: S is the second variation of torsion, with bending and lengths eliminated, and 1 / D^2 without coupling. */
static void soften(const void *of, double *x) {
    Workspace *w = (Workspace *)of;
    const Layout *l = &w->layout;
    const Tubes *t = l->tubes;
    int k = l->rule->degree, n = 0;
    memset(&w->by, 0, sizeof w->by);
    for (int pass = 0; pass < 2; pass++, n = 0) {
        for (int i = 0; i < N; i++) {
            if (!(t->behind[i] > 0)) continue;
            double root = sqrt(t->kt[i] / t->behind[i]);
            if (!pass) w->by.twist[i] = x[n++] * root;
            else x[n++] = -w->most * w->step.twist[i] * root;
        }
        for (int y = 0; y < l->points; y++)
            for (int i = 0; i < N; i++) {
                if (!l->present[l->section[y / k]][i]) continue;
                double root = sqrt(l->rule->weights[y % k] * t->kt[i] / w->state.length[y][i]);
                if (!pass) w->by.value[y][N + i] = x[n++] * root;
                else x[n++] = -w->most * w->step.turn[y][i] * root;
            }
        if (!pass) solve_step(l, &w->factors, &w->by, &w->step);
    }
}

/* Least eigenvalue of S relative to 1 / D^2, at most 1. Eigenvalues near 1 are close to one another: where it is one of
   them, a few steps with S less nearly that much separate it from the others. */
static double margin_of(Workspace *w) {
    const Layout *l = &w->layout;
    int n = 0;
    double margin;
    for (int i = 0; i < N; i++) n += l->tubes->behind[i] > 0;
    for (int y = 0; y < l->points; y++)
        for (int i = 0; i < N; i++) n += l->present[l->section[y / l->rule->degree]][i];
    anywhere(w->vector, n);
    Krylov inverse = {soften, w, 1, n, FIRST_LANCZOS, MOST_UNKNOWNS, 0, EIGENVALUE_ERROR, EIGENVALUE_ERROR, 1, w->basis[0], 0};
    w->most = 1;
    margin = 1 / largest_of(&inverse, w->vector);
    if (inverse.settled) return fmin(1, margin);
    inverse.steps = LANCZOS;
    w->most = FARTHER * fmax(1 - margin, NEAR_ONE);
    while (w->most < 1 && !factorise(l, &w->state, w->most - 1, &w->factors)) w->most *= FARTHER;
    if (w->most >= 1) {
        w->most = 1;
        if (!factorise(l, &w->state, 0, &w->factors)) return 0;
    }
    inverse.most = w->most;
    return fmin(1, 1 - w->most * (1 - 1 / largest_of(&inverse, w->vector)));
}

/* The arm at the shape points, by poses (R by columns, then p) that `carry` moves on. */
static void lay_arm(const Layout *l, const State *state, const double *alpha, Answer *out) {
    int k = l->rule->degree;
    double pose[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, base[N], start = 0;
    for (int i = 0; i < N; i++) base[i] = alpha[i] + state->twist[i];
    for (int e = 0; e < l->pieces; e++) {
        double h = state->h[l->section[e]];
        for (int s = e ? 1 : 0; s <= STEPS; s++) {
            int at = e * STEPS + s;
            if (s) {
                double u[6] = {0}, step = h / STEPS, next[12];
                for (int g = 0; g < 3; g++)
                    for (int a = 0; a < k; a++)
                        for (int c = 0; c < 2; c++)
                            u[2 * g + c] += l->rule->inside[(3 * (s - 1) + g) * k + a] * state->bend[e * k + a][c] / h;
                const double *in[] = {pose, u, &step};
                double *res[] = {next};
                carry(in, res, 0, 0, 0);
                memcpy(pose, next, sizeof pose);
            }
            out->arc_length[at] = start + h * s / STEPS;
            memset(out->curvature[at], 0, sizeof out->curvature[at]);
            for (int i = 0; i < N; i++) out->rotation[at][i] = base[i], out->torsion[at][i] = 0;
            for (int a = 0; a < k; a++) {
                double basis = l->rule->basis[s * k + a], once = l->rule->once[s * k + a];
                for (int i = 0; i < N; i++) {
                    out->rotation[at][i] += once * state->turn[e * k + a][i];
                    out->torsion[at][i] += basis * state->turn[e * k + a][i] / h;
                }
                for (int c = 0; c < 2; c++) out->curvature[at][c] += basis * state->bend[e * k + a][c] / h;
            }
            for (int r = 0; r < 9; r++) out->frame[at][r] = pose[3 * (r % 3) + r / 3];
            memcpy(out->position[at], pose + 9, 3 * sizeof(double));
        }
        for (int a = 0; a < k; a++) out->point[e * k + a] = start + h * l->rule->nodes[a];
        memcpy(base, out->rotation[(e + 1) * STEPS], sizeof base);
        start += h;
    }
}

static void lay_sections(const Layout *l, const State *state, Answer *out) {
    int k = l->rule->degree;
    double start = 0;
    for (int j = 0, pieces = 0; j < l->sections; j++) {
        out->section_start[j] = start;
        start += l->count[j] * state->h[j];
        pieces += l->count[j];
        for (int i = 0; i < N; i++) {
            if (!(l->tubes->boundary[l->order[j]].ends[i] > 0)) continue;
            out->tube_end[i] = start;
            out->tip_rotations[i] = out->rotation[pieces * STEPS][i];
        }
    }
    for (int x = 0; x < l->points; x++)
        for (int c = 0; c < 2; c++) out->bent[x][c] = state->bend[x][c] / state->h[l->section[x / k]];
    memcpy(out->theta, state->theta, l->points * sizeof state->theta[0]);
    out->pieces = l->pieces;
    out->sections = l->sections;
    out->energy = state->energy;
}

/* Errors: what a Newton step with one point more per element changes. */
static int compare_finer(const double *alpha, Workspace *w, Answer *out) {
    const Layout *l = &w->layout;
    Layout *check = &w->check;
    State *finer = &w->finer;
    int k = l->rule->degree, m = CHECK_DEGREE, tip = l->pieces * STEPS;
    memcpy(check, l, sizeof *l);
    check->rule = RULE + 1;
    check->points = l->pieces * m;
    memset(finer->turn, 0, sizeof finer->turn);
    memset(finer->bend, 0, sizeof finer->bend);
    for (int x = 0; x < check->points; x++)
        for (int a = 0; a < k; a++) {
            double basis = TO_CHECK[x % m * k + a];
            for (int i = 0; i < N; i++) finer->turn[x][i] += basis * w->state.turn[x / m * k + a][i];
            for (int c = 0; c < 2; c++) finer->bend[x][c] += basis * w->state.bend[x / m * k + a][c];
        }
    memcpy(finer->h, w->state.h, sizeof finer->h);
    memcpy(finer->twist, w->state.twist, sizeof finer->twist);
    if (!evaluate(check, alpha, finer) || !factorise(check, finer, 0, &w->factors)) return DECLINED;
    gradient_of(check, finer, &w->by);
    solve_step(check, &w->factors, &w->by, &w->step);
    out->theta_error = 0;
    for (int x = 0; x < check->points; x++) out->theta_error = fmax(out->theta_error, 2 * largest(w->step.theta[x], N));
    take_step(check, finer, &w->step, 1, finer);
    lay_arm(check, finer, alpha, &w->arm);
    out->tip_error = 0;
    for (int c = 0; c < 3; c++) out->tip_error = hypot(out->tip_error, w->arm.position[tip][c] - out->position[tip][c]);
    return SOLVED;
}

/* The stable equilibrium at rotations alpha (N), from one close by, or from tubes without torsion; elements are then halved
   `halvings` times. */
CASADI_SYMBOL_EXPORT int solve_bundle(const Tubes *t, const double *alpha, const Start *from, long long halvings,
                                      Workspace *w, Answer *out) {
    Layout *l = &w->layout;
    int closed, passed = 0, growth = GROWS, exchanged[MOST_SECTIONS][MOST_SECTIONS] = {{0}}, freed[MOST_SECTIONS][MOST_SECTIONS] = {{0}};
    out->iterations = 0;
    out->contraction = out->largest_change = 0;
    if (!(from ? take_up(t, from, l, &w->state) : begin(t, alpha, (int)halvings, l, &w->state))) return DECLINED;
    while (growth == GROWS) {
        while (minimise(l, alpha, from != NULL, w, out, &closed)) {
            if (!closed || !exchange(l, &w->state, closed, exchanged)) return DECLINED;
            out->contraction = 0; /* the first steps then open the section, and say nothing about the branch */
            passed = 1;
        }
        growth = grown(l, alpha, w, freed);
        /* Along a branch that is left to the general solver: sections that open may lead to another one. */
        if (growth == UNKNOWN || (growth == GROWS && from)) return DECLINED;
    }
    lay_arm(l, &w->state, alpha, out);
    lay_sections(l, &w->state, out);
    if (from) out->largest_change = twisted_since(l, alpha, from, &w->state);
    /* Where ends pass each other the arm may jump, and Newton's method converges well behind the jump. */
    if (passed && out->largest_change > LARGEST_EXCHANGE) return DECLINED;
    if (!factorise(l, &w->state, 0, &w->factors)) return DECLINED;
    out->margin = margin_of(w);
    if (!(out->margin > LEAST_STIFFNESS)) return DECLINED;
    return compare_finer(alpha, w, out);
}
