/* Forward kinematics under load: what block/transcription/loaded.py states, solved by Newton's method as the load grows.

   Before it stand the functions that CasADi generates: `bending` of a cross-section, `quaternion_product` and
   `rotation_matrix`, and the tables TANGENT and TURN of the tangent and of turns about world axes by a quaternion. What
   is not plain sailing is declined, and left to the general solver. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MOST_POINTS (MOST_PIECES * MOST_DEGREE)
#define MOST_SHAPE (MOST_PIECES * STEPS + 1)
#define MOST_UNKNOWNS (N + MOST_POINTS * (N + 2))
#define STATE (N + 4)                                                  /* rotations and quaternion where a piece begins */
#define WIDTH ((((N + 2) * MOST_DEGREE + 3) / 4 + (STATE + 3) / 4) * 4) /* of the matrix of a piece */

enum { SOLVED = 0, DECLINED = 1 };

#include "linear.c"

/* A robot under a load on a mesh: P pieces of K points. Tubes are `bent` on a piece where they have unknown rotations, and
   `felt` where their twist has any effect. */
typedef struct {
    long long pieces, degree, tip_tube;
    double whole; /* length of the arm */
    const double *weights, *matrix, *start, *length;         /* (K), (K, K), (P), (P) */
    const double *stiffness, *moment, *phase, *rate;         /* (P K, N); rate is 1 / kt */
    const double *bent, *felt, *held;                        /* (P, N), (P, N), (N): compliance behind the plate */
    const double *force, *base_force;                        /* (P K, 3), (3) */
    const double *basis, *once, *twice;                      /* (5, K) Lagrange basis at the shape points, integrated */
    const double *ends_stiffness, *ends_moment, *ends_phase; /* (5 P, N) there */
    const double *ends_rate, *ends_twist, *ends_wound;
} Problem;

typedef struct {
    double margin, residual, theta_error, tip_error, margin_error, energy, work;
    long long iterations;
    double theta[MOST_POINTS][N], curvature[MOST_POINTS][2];
    double compliance[36], base_wrench[6];
    double arc_length[MOST_SHAPE], rotation[MOST_SHAPE][N], torsion[MOST_SHAPE][N];
    double bent[MOST_SHAPE][2], position[MOST_SHAPE][3], frame[MOST_SHAPE][9];
} Answer;

#include "loaded_state.c"
#include "loaded_sweep.c"
#include "loaded_newton.c"
#include "loaded_arm.c"

typedef struct {
    Stage stage, check;
    State state, trial, fine;
    Step step, fine_step;
    Room room;
} Workspace;

size_t workspace_size(void) { return sizeof(Workspace); }
size_t answer_size(void) { return sizeof(Answer); }

/* The margin on a finer rule, by the direction that is softest on the other: off by the square of what that is. */
static double margin_beside(const Stage *stage, const Stage *check, const double *to_fine, Workspace *w) {
    const Problem *p = stage->problem, *finer = check->problem;
    int k = stage->degree, m = check->degree, n = unknowns_of(check);
    const double *from = w->room.vector;
    double *to = w->room.basis[0], *image = w->room.basis[1];
    memcpy(to, from, N * sizeof(double));
    from += N;
    to += N;
    for (int e = 0; e < stage->pieces; e++)
        for (int i = 0; i < N; i++) {
            int bent = stage->piece[e].count[i] == k;
            for (int a = 0; a < m && bent; a++) {
                to[a] = 0;
                for (int b = 0; b < k; b++)
                    to[a] += to_fine[a * k + b] * from[b] * sqrt(p->rate[(e * k + b) * N + i] / p->weights[b]);
                to[a] *= sqrt(finer->weights[a] / finer->rate[(e * m + a) * N + i]);
            }
            if (!bent && stage->piece[e].count[i]) *to = *from;
            from += stage->piece[e].count[i];
            to += check->piece[e].count[i];
        }
    for (int x = 0; x < check->points; x++, to += 2)
        for (int j = 0; j < 2; j++) {
            to[j] = 0;
            for (int b = 0; b < k; b++) {
                int y = x / m * k + b;
                to[j] += to_fine[x % m * k + b] * stage->soft[y] * from[2 * y + j] / check->soft[x];
            }
        }
    to = w->room.basis[0];
    memcpy(image, to, n * sizeof(double));
    Softness of = {check, &w->fine_step};
    memset(w->fine_step.by.end, 0, sizeof w->fine_step.by.end);
    w->fine_step.by.has_orientation = 0;
    w->fine_step.by.has_twist = 1;
    soften(&of, image);
    return fmin(1, dot(to, to, n) / dot(to, image, n));
}

/* What a Newton step on a finer rule changes: of theta, of the tip and, where loads hardly soften, of the margin. */
static int compare_finer(const Problem *fine, const double *to_fine, const double *alpha, Workspace *w, Answer *out) {
    const Stage *stage = &w->stage;
    Stage *check = &w->check;
    int k = stage->degree, m = (int)fine->degree;
    prepare(check, fine);
    for (int x = 0; x < check->points; x++) {
        const double *row = to_fine + (x % m) * k;
        int from = x / m * k;
        for (int i = 0; i < N; i++) {
            w->fine.theta[x][i] = 0;
            for (int b = 0; b < k; b++) w->fine.theta[x][i] += row[b] * w->state.theta[from + b][i];
        }
        for (int j = 0; j < 2; j++) {
            double bend = 0;
            for (int b = 0; b < k; b++) bend += row[b] * stage->soft[from + b] * w->state.q[from + b][j];
            w->fine.q[x][j] = bend / check->soft[x];
        }
    }
    evaluate(check, &w->fine, 1);
    if (!factorise(check, &w->fine, 1, 1)) return DECLINED;
    newton_step(check, &w->fine, alpha, 1, &w->fine_step);
    out->theta_error = theta_change(check, &w->fine, &w->fine_step);
    double tip[3], here[3], gap[3];
    tip_of(stage, &w->state, here);
    tip_of(check, &w->fine, tip);
    tip_moved(check, &w->fine, &w->fine_step, gap);
    for (int i = 0; i < 3; i++) gap[i] += tip[i] - here[i];
    out->tip_error = sqrt(dot(gap, gap, 3));
    out->margin_error = 0;
    if (out->margin > HARDLY_SOFTENED) out->margin_error = fabs(margin_beside(stage, check, to_fine, w) - out->margin);
    return SOLVED;
}

/* theta and q of an equilibrium whose theta (P K, N) and curvature (P K, 2) at the points are known; `turn` (N) is added.
   NULL is the curvature without load. Tubes without unknowns are where they are held. */
static void take_up(const Stage *s, const double *alpha, const double *theta, const double *turn, const double *curvature, State *state) {
    const Problem *p = s->problem;
    for (int x = 0; x < s->points; x++) {
        double direction[N], natural[2];
        for (int i = 0; i < N; i++) {
            int bent = s->piece[x / s->degree].count[i] == s->degree;
            state->theta[x][i] = bent ? theta[x * N + i] + turn[i] : alpha[i];
            direction[i] = theta[x * N + i] + p->phase[x * N + i];
        }
        const double *in[3] = {direction, p->stiffness + x * N, p->moment + x * N};
        double *out[6] = {0, 0, 0, natural, 0, 0};
        if (curvature) bending(in, out, 0, 0, 0);
        for (int j = 0; j < 2; j++)
            state->q[x][j] = curvature ? (curvature[2 * x + j] - natural[j]) / s->soft[x] : 0;
    }
}

/* The stable equilibrium under the whole load from that without load, with a `margin` of NaN, or from one close by of this
   margin: its theta and curvature at the points. */
int solve_loaded(const Problem *problem, const Problem *fine, const double *to_fine, const double *alpha,
                 const double *turn, const double *theta, const double *curvature, double margin, Workspace *w,
                 Answer *out) {
    Stage *stage = &w->stage;
    prepare(stage, problem);
    take_up(stage, alpha, theta, turn, curvature, &w->state);
    out->iterations = 0;
    int failed = curvature ? settle(stage, alpha, margin, &w->state, &w->trial, &w->step, out)
                           : grow(stage, alpha, margin, &w->room, &w->state, &w->trial, &w->step, out);
    if (failed) return DECLINED;
    tip_compliance(stage, &w->state, &w->step, w->room.basis[0], out->compliance);
    lay_arm(stage, &w->state, alpha, out);
    out->margin = margin_of(stage, &w->state, curvature ? margin : NAN, &w->step, &w->room);
    if (!(out->margin > LEAST_STIFFNESS)) return DECLINED;
    return compare_finer(fine, to_fine, alpha, w, out);
}
