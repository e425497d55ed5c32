/* Forward kinematics under load: what block/transcription/loaded.py states, solved by Newton's method as the load grows.

   Before it stand the functions that CasADi generates: `bending` of a cross-section and `rotation_matrix`, and the tables
   TANGENT and TURN of the tangent and of turns about world axes by a quaternion. What is not plain sailing is declined,
   and left to the general solver. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MOST_POINTS (MOST_PIECES * MOST_DEGREE)
#define MOST_SHAPE (MOST_PIECES * STEPS + 1)
#define MOST_UNKNOWNS (N + MOST_POINTS * (N + 2))
#define STATE (N + 4)                                                  /* rotations and quaternion where a piece begins */
#define WIDTH ((((N + 2) * MOST_DEGREE + 3) / 4 + (STATE + 3) / 4) * 4) /* of the matrix of a piece */

enum { SOLVED = 0, DECLINED = 1 };

#include "four.c"
#include "sections.c"
#include "linear.c"

/* Points per piece, and what does not depend on the robot: of the answer, of the growing of the load, of the check. */
typedef struct {
    int degree;
    const double *nodes, *weights, *matrix; /* (K), (K), (K, K) */
    const double *basis, *once, *twice;     /* (5, K) Lagrange basis at the shape points, integrated */
} Rule;

#define RULE_OF(k, degree) \
    {degree, RULE##k##_nodes, RULE##k##_weights, RULE##k##_matrix, RULE##k##_basis, RULE##k##_once, RULE##k##_twice}
static const Rule RULE[] = {RULE_OF(0, DEGREE), RULE_OF(1, ROUGH_DEGREE), RULE_OF(2, CHECK_DEGREE)};

/* A robot under a load on a mesh: P pieces of K points. Tubes are `bent` on a piece where they have unknown rotations, and
   `felt` where their twist has any effect. */
typedef struct {
    long long pieces, tip_tube;
    double whole; /* length of the arm */
    const double *start, *length;                            /* (P), (P) */
    const double *bent, *felt, *held;                        /* (P, N), (P, N), (N): compliance behind the plate */
    const Sections *at, *ends;                               /* (P K), and (5 P) where pieces are cut for the shape */
    const double *ends_twist, *force, *base_force;           /* (5 P, N) u*_z there, (P K, 3), (3) */
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

/* One robot under one load on the three rules with the same pieces. */
typedef struct {
    Problem problem, rough, check;
} Rules;

typedef struct {
    Stage stage, rough, check;
    State state, trial, other, rough_state;
    Step step, other_step;
    Room room;
} Workspace;

CASADI_SYMBOL_EXPORT size_t workspace_size(void) { return sizeof(Workspace); }
CASADI_SYMBOL_EXPORT size_t answer_size(void) { return sizeof(Answer); }

/* The margin on a finer rule, by the direction that is softest on the other: off by the square of what that is. */
static double margin_beside(const Stage *stage, const Stage *check, Workspace *w) {
    int n = unknowns_of(check);
    double *to = w->room.basis[0], *image = w->room.basis[1];
    carry_direction(stage, w->room.vector, check, TO_CHECK, to);
    memcpy(image, to, n * sizeof(double));
    Softness of = {check, &w->other_step};
    soften(&of, image);
    return fmin(1, dot(to, to, n) / dot(to, image, n));
}

/* What a Newton step on a finer rule changes: of theta, of the tip and, where loads hardly soften, of the margin. */
static int compare_finer(const double *alpha, Workspace *w, Answer *out) {
    const Stage *stage = &w->stage;
    Stage *check = &w->check;
    carry_over(stage, &w->state, check, TO_CHECK, &w->other);
    evaluate(check, &w->other, 1);
    if (!factorise(check, &w->other, 1, 1)) return DECLINED;
    newton_step(check, &w->other, alpha, 1, &w->other_step, 1);
    out->theta_error = largest_turn(check, &w->other, (const double(*)[N])w->other_step.theta);
    double tip[3], here[3], gap[3];
    tip_of(stage, &w->state, here);
    tip_of(check, &w->other, tip);
    tip_moved(check, &w->other, &w->other_step, gap);
    for (int i = 0; i < 3; i++) gap[i] += tip[i] - here[i];
    out->tip_error = sqrt(dot(gap, gap, 3));
    out->margin_error = 0;
    if (out->margin > HARDLY_SOFTENED)
        out->margin_error = fabs(margin_beside(stage, check, w) - out->margin);
    return SOLVED;
}

/* theta and q of an equilibrium whose theta (P K, N) and curvature (P K, 2) at the points are known; `turn` (N) is added.
   NULL is the curvature without load. Tubes without unknowns are where they are held. */
static void take_up(const Stage *s, const double *alpha, const double *theta, const double *turn, const double *curvature, State *state) {
    for (int x = 0; x < s->points; x++) {
        double natural[2];
        for (int i = 0; i < N; i++) {
            int bent = s->piece[x / s->degree].count[i] == s->degree;
            state->theta[x][i] = bent ? theta[x * N + i] + turn[i] : alpha[i];
        }
        if (curvature) bend_freely(&s->problem->at[x], theta + x * N, natural);
        for (int j = 0; j < 2; j++)
            state->q[x][j] = curvature ? (curvature[2 * x + j] - natural[j]) / s->soft[x] : 0;
    }
}

/* The equilibrium under the whole load on the branch of the unloaded one in w->state, of this margin: grown on few points,
   what that changes carried over, and settled. Returns about the margin, NaN where this fails. */
static double grow_roughly(const double *alpha, double margin, Workspace *w, Answer *out) {
    Stage *stage = &w->stage, *rough = &w->rough;
    State *here = &w->rough_state;
    carry_over(stage, &w->state, rough, TO_ROUGH, here);
    for (int x = 0; x < rough->points; x++) memcpy(w->other.theta[x], here->theta[x], sizeof here->theta[x]);
    if (grow(rough, alpha, margin, &w->room, here, &w->trial, &w->step, out)) return NAN;
    margin = rough_margin(rough, 0, &w->step, &w->room);
    for (int x = 0; x < rough->points; x++)
        for (int i = 0; i < N; i++) here->theta[x][i] -= w->other.theta[x][i];
    carry_over(rough, here, stage, FROM_ROUGH, &w->trial);
    for (int x = 0; x < stage->points; x++) {
        for (int i = 0; i < N; i++) w->state.theta[x][i] += w->trial.theta[x][i];
        memcpy(w->state.q[x], w->trial.q[x], sizeof w->state.q[x]);
    }
    if (settle(stage, alpha, margin, &w->state, &w->trial, &w->step, out)) return NAN;
    return margin;
}

static void prepare_all(const Rules *rules, Workspace *w) {
    prepare(&w->stage, &rules->problem, RULE);
    prepare(&w->rough, &rules->rough, RULE + 1);
    prepare(&w->check, &rules->check, RULE + 2);
}

static int solve_prepared(const double *alpha, const double *turn, const double *theta, const double *curvature,
                          double margin, Workspace *w, Answer *out) {
    Stage *stage = &w->stage;
    double near = margin;
    take_up(stage, alpha, theta, turn, curvature, &w->state);
    out->iterations = 0;
    if (curvature) {
        if (settle(stage, alpha, margin, &w->state, &w->trial, &w->step, out)) return DECLINED;
    } else if (isnan(near = grow_roughly(alpha, margin, w, out))) {
        take_up(stage, alpha, theta, turn, curvature, &w->state);
        if (grow(stage, alpha, margin, &w->room, &w->state, &w->trial, &w->step, out)) return DECLINED;
    }
    tip_compliance(stage, &w->state, &w->step, w->room.basis[0], out->compliance);
    lay_arm(stage, &w->state, alpha, out);
    anywhere(w->room.vector, unknowns_of(stage));
    out->margin = margin_of(stage, &w->state, near, EIGENVALUE_ERROR, &w->step, &w->room);
    if (!(out->margin > LEAST_STIFFNESS)) return DECLINED;
    return compare_finer(alpha, w, out);
}

/* The stable equilibrium under the whole load from that without load, without a `curvature`, or from one close by, each of
   this margin: its theta and curvature at the points. */
CASADI_SYMBOL_EXPORT int solve_loaded(const Rules *rules, const double *alpha, const double *turn, const double *theta,
                                      const double *curvature, double margin, Workspace *w, Answer *out) {
    prepare_all(rules, w);
    return solve_prepared(alpha, turn, theta, curvature, margin, w, out);
}

/* Many rotations, each from its equilibrium without load, of `margin` (count) and `theta` (count, points, N). `summary`
   (count, SUMMARY) gets tip position (3), tip frame by rows (9), rotations of the tubes at their `ends` among the shape
   points, margin, residual, errors of theta and tip, energy, error of the margin; `compliance` (count, 36) that of the tip;
   `declined` (count) what is left over. */
CASADI_SYMBOL_EXPORT void solve_many_loaded(const Rules *rules, long long count, const double *alpha, const double *theta,
                                            const double *margin, const long long *ends, double *summary,
                                            double *compliance, unsigned char *declined, Workspace *w, Answer *one) {
    double none[N] = {0};
    prepare_all(rules, w);
    for (long long k = 0; k < count; k++, summary += 18 + N, compliance += 36) {
        declined[k] = solve_prepared(alpha + k * N, none, theta + k * w->stage.points * N, NULL, margin[k], w, one) != SOLVED;
        if (declined[k]) continue;
        int tip = w->stage.pieces * STEPS;
        memcpy(summary, one->position[tip], 3 * sizeof(double));
        memcpy(summary + 3, one->frame[tip], 9 * sizeof(double));
        for (int i = 0; i < N; i++) summary[12 + i] = one->rotation[ends[i]][i];
        double rest[6] = {one->margin,    one->residual, one->theta_error,
                          one->tip_error, one->energy,   one->margin_error};
        memcpy(summary + 12 + N, rest, sizeof rest);
        memcpy(compliance, one->compliance, sizeof one->compliance);
    }
}
