/* From the solved rotations to the whole arm: what block/transcription/arm.py does. */

/* theta' = c t + extra with the torque t, t' = M, and the mean c of 1 / kt on the piece. */
typedef struct {
    Real rotation[MOST_PIECES + 1][N], torque[MOST_PIECES][N]; /* where pieces begin; rotation at the tip, too */
    Real moment[MOST_PIECES][MOST_DEGREE * N];                 /* M, (K, n) */
    Real extra[MOST_PIECES][MOST_DEGREE * N];                  /* (g / kt - c) t, where it is not 0 */
    Real compliance[MOST_PIECES][N];                           /* c */
} Profile;

#define ANSWER(Real) struct { \
    Real margin, residual, mesh_error, tip_error, energy, contraction, largest_change; \
    long long pieces, points, sections, iterations, elements; \
    Real tip_rotations[N], tube_end[N], section_start[MOST_SECTIONS + 1]; \
    Real point[MOST_POINTS], point_rotation[MOST_POINTS][N]; \
    Real arc_length[MOST_SHAPE], rotation[MOST_SHAPE][N], torsion[MOST_SHAPE][N]; \
    Real curvature[MOST_SHAPE][2], position[MOST_SHAPE][3], frame[MOST_SHAPE][9]; \
}
typedef ANSWER(double) Answer;
#if ABREAST
typedef ANSWER(Real) Answers; /* of robots side by side; tube ends and starts of sections are of the first */
#else
typedef Answer Answers;
#endif

/* Whether a tube turns by c t alone on a piece: it is even and on the centreline. */
static int turns_evenly(const Unknowns *q, int p, int i) { return !ECCENTRIC && q->layout->across[p].even[i]; }

/* t of a tube at point k of a piece. */
static Real torque_at(const Unknowns *q, const Profile *arm, int p, int k, int i) {
    Real torque = arm->torque[p][i];
    int degree = q->tableau->degree;
    for (int j = 0; j < degree; j++)
        torque += q->length[p] * q->tableau->matrix[k * degree + j] * arm->moment[p][j * N + i];
    return torque;
}

/* The mean of 1 / kt on a piece; what the torque turns a tube by beyond it goes to arm->extra. */
static Real even_out(const Unknowns *q, Profile *arm, int p, int i) {
    const Tableau *t = q->tableau;
    Real mean = {0};
    for (int k = 0; k < t->degree; k++) mean += t->weights[k] * q->rate[p][k][i];
    for (int k = 0; k < t->degree; k++)
        arm->extra[p][k * N + i] = torque_at(q, arm, p, k, i) * (q->rate[p][k][i] - mean);
    return mean;
}

/* What t' and theta' gain where pieces begin and at the tip, and theta' at the points (K, n) of tubes that vary. */
typedef struct {
    Real kicks[MOST_PIECES + 1][N], jolts[MOST_PIECES + 1][N], twists[MOST_PIECES][MOST_DEGREE * N];
} Gains;

/* theta_i(s) as one polynomial per piece, from arm->moment and arm->extra, base rotations, and gains or NULL. Of an arm of
   length zero, theta and theta' at the plate. */
static void turn_along(const Unknowns *q, const Real *alpha, const Gains *gains, Profile *arm) {
    const Layout *l = q->layout;
    const Tableau *t = q->tableau;
    Real turn[MOST_PIECES][N], at[N];
    memset(at, 0, sizeof at);
    for (int i = 0; i < N && gains; i++) at[i] -= gains->kicks[l->pieces][i];
    for (int p = l->pieces - 1; p >= 0; p--) {
        Real h = q->length[p];
        for (int i = 0; i < N; i++) {
            Real gain = {0}, later = {0}, extra = {0};
            for (int k = 0; k < t->degree; k++) {
                Real m = arm->moment[p][k * N + i];
                gain += t->weights[k] * m;
                later += t->weights[k] * (1 - t->nodes[k]) * m;
            }
            at[i] -= h * gain;
            arm->torque[p][i] = at[i];
            arm->compliance[p][i] = l->across[p].even[i] ? q->rate[p][0][i] : even_out(q, arm, p, i);
            for (int k = 0; k < t->degree && gains && !l->across[p].even[i]; k++)
                arm->extra[p][k * N + i] += gains->twists[p][k * N + i];
            for (int k = 0; k < t->degree && !turns_evenly(q, p, i); k++)
                extra += t->weights[k] * arm->extra[p][k * N + i];
            turn[p][i] = arm->compliance[p][i] * (h * at[i] + h * h * later) + h * extra;
            if (gains) at[i] -= gains->kicks[p][i];
        }
    }
    for (int i = 0; i < N; i++) {
        if (!l->pieces) arm->torque[0][i] = at[i];
        at[i] = alpha[i] + q->held[i] * at[i];
    }
    for (int p = 0; p <= l->pieces; p++)
        for (int i = 0; i < N; i++) {
            arm->rotation[p][i] = at[i] += gains ? gains->jolts[p][i] : REAL(0.0);
            if (p < l->pieces) at[i] += turn[p][i];
        }
}

/* theta_i(s) from the moments at the collocation points. */
static void integrate(const Unknowns *q, const Real *alpha, const State *state, Profile *arm) {
    int x = 0, degree = q->tableau->degree;
    for (int p = 0; p < q->layout->pieces; p++) {
        int collocated = q->layout->collocated[p];
        for (int k = 0; k < degree; k++)
            for (int i = 0; i < N; i++) {
                arm->moment[p][k * N + i] = collocated ? state->moment[x + k][i] : REAL(0.0);
#if ECCENTRIC
                arm->extra[p][k * N + i] = collocated ? state->extra[x + k][i] : 0;
#endif
            }
        if (collocated) x += degree;
    }
    turn_along(q, alpha, NULL, arm);
}

/* theta of a tube at fraction x of a piece, of tubes off the centreline without `extra`; `once`, `twice`: the Lagrange
   basis (degree) there, integrated. */
static Real rotation_at(const Unknowns *q, const Profile *arm, int p, int i, double x, const double *once,
                          const double *twice) {
    Real h = q->length[p], bent = {0}, uneven = {0};
    int degree = q->tableau->degree;
    for (int k = 0; k < degree; k++) bent += twice[k] * arm->moment[p][k * N + i];
    for (int k = 0; k < degree && !q->layout->across[p].even[i]; k++) uneven += once[k] * arm->extra[p][k * N + i];
    return arm->rotation[p][i] + h * (arm->compliance[p][i] * (x * arm->torque[p][i] + h * bent) + uneven);
}

/* theta at the points of `fine`, from the arm on the tableau of `coarse`; `bases` is the Lagrange basis integrated once
   and twice, (2, fine K, coarse K). */
static void interpolate(const Unknowns *coarse, const Profile *arm, const Unknowns *fine, const double *bases,
                        Real theta[][N]) {
    int degree = coarse->tableau->degree, k = fine->tableau->degree;
    for (int x = 0; x < fine->points; x++) {
        const double *once = bases + (x % k) * degree, *twice = once + k * degree;
        for (int i = 0; i < N; i++)
            theta[x][i] = rotation_at(coarse, arm, fine->piece[x], i, fine->tableau->nodes[x % k], once, twice);
    }
}

#define COUPLING_FLOOR 1e-10 /* a margin closer to 1 is 1 */
#define FLAT (1 - 1e-9)      /* margin above which nothing softens */

/* Whether the elastic coupling L' B V'' L has no negative eigenvalue below -COUPLING_FLOOR: then the margin is 1. One
   elimination finds that out; Lanczos' method would search for a mode among those that gather at 1. */
static Truth never_softens(const Unknowns *q, const State *state, Chain *h) {
    return factor_variation(q, state, REAL(COUPLING_FLOOR), h);
}

/* Least eigenvalue of the second variation at a solved state, at most 1; not positive where it is not stable. */
static Real margin_of(const Unknowns *q, const State *state, Chain *h) {
    Real z[MOST_UNKNOWNS];
    if (!q->size) return REAL(1.0);
    Truth rigid = never_softens(q, state, h);
    if (ALL(rigid)) return REAL(1.0);
    Truth stable = factor_variation(q, state, REAL(1.0), h);
    if (!ANY(stable)) return REAL(-1.0);
    anywhere(z, q->size);
    Real least = least_eigenvalue((Factored){q, h, NULL, NULL}, EIGENVALUE_ERROR, 0, rigid | NOT(stable), z);
    return CHOOSE(rigid, 1.0, CHOOSE(stable, fmin(REAL(1.0), least), -1.0));
}

/* Where to start from: samples of another arm along its arc length, or, where that has the same collocation points, what
   it has there; `turn` (n) is added. */
typedef struct {
    long long count, points, apart, next; /* numbers from the samples of a tube to those of the next, and from one to the next */
    const double *s, *rotation, *torsion; /* (count), and by tubes */
    const double *point, *point_rotation; /* (points), (points, n) */
    const double *turn;
    const double *shift; /* (n) translations there */
} Guess;

/* theta of a robot at the points from a guess; cubic between samples. */
static void sample(const Unknowns *q, const Guess *g, int which, Real theta[][N]) {
    int k = 0, count = (int)g->count, same = g->points == q->points, winding[N];
    for (int i = 0; i < N; i++) winding[i] = winds(q->tubes->pieces, i);
    for (int x = 0; x < q->points && same; x++) same = g->point[x] == OF_ROBOT(q->s[x], which);
    for (int x = 0; x < q->points; x++) {
        double s = OF_ROBOT(q->s[x], which);
        while (k + 2 < count && g->s[k + 1] <= s) k++;
        double h = count > 1 ? g->s[k + 1] - g->s[k] : 1, t = fmin(fmax((s - g->s[k]) / h, 0), 1), u = 1 - t, here;
        for (int i = 0; i < N; i++) {
            long long at = i * g->apart + k * g->next;
            const double *r = g->rotation + at, *w = g->torsion + at;
            if (same)
                here = g->point_rotation[x * N + i];
            else if (count < 2)
                here = r[0];
            else
                here = r[0] * (1 + 2 * t) * u * u + r[g->next] * t * t * (3 - 2 * t) + h * t * u * (w[0] * u - w[g->next] * t);
            here += g->turn[i];
            if (winding[i]) here -= twist_angle_at(q->tubes->pieces, i, s + fmax(q->tubes->straight[i] - g->shift[i], 0.0));
            OF_ROBOT(theta[x][i], which) = here;
        }
    }
}

/* Points where the shape is evaluated along a piece: at 3 points of each of `steps` Magnus steps, at the shape points, and at
   those of a finer quadrature; with the Lagrange basis at all `count` points, integrated once and twice, (K, count). */
typedef struct {
    int steps, count;
    const double *points, *once, *twice;
} Looks;

#define CHECK_DEGREE (MOST_DEGREE + EXTRA_POINTS)
#define MOST_LOOKS VARIED_COUNT

static const Looks EVEN = {STEPS, EVEN_COUNT, EVEN_POINTS, EVEN_ONCE, EVEN_TWICE};
static const Looks VARIED = {SUBSTEPS * STEPS, VARIED_COUNT, VARIED_POINTS, VARIED_ONCE, VARIED_TWICE};

/* All tubes at a point: phi, the directions of their pulls, and what they are. */
typedef struct {
    Real phi[N], direction[N];
    SectionsAbreast tubes;
} Place;

static void find_places(const Unknowns *q, const Profile *arm, int p, const Looks *at, Place *places) {
    Real h = q->length[p];
    for (int i = 0; i < N; i++) {
        Real phi[MOST_LOOKS], c = arm->compliance[p][i], torque = arm->torque[p][i];
        int evenly = turns_evenly(q, p, i);
        for (int g = 0; g < at->count; g += 4) {
            Four bent, extra;
            memset(&bent, 0, sizeof bent);
            memset(&extra, 0, sizeof extra);
            for (int k = 0; k < MOST_DEGREE; k++)
                EACH(OF(bent) += arm->moment[p][k * N + i] * FOUR(at->twice + k * at->count + g));
            for (int k = 0; k < MOST_DEGREE && !evenly; k++)
                EACH(OF(extra) += arm->extra[p][k * N + i] * FOUR(at->once + k * at->count + g));
            EACH(FOUR(phi + g) = h * (c * (torque * FOUR(at->points + g) + h * OF(bent)) + OF(extra)) + arm->rotation[p][i]);
        }
        for (int g = 0; g < at->count; g++) {
            SectionAbreast here = section_here(q, p, i, at->points[g]);
            places[g].phi[i] = phi[g];
            places[g].direction[i] = phi[g] + here.phase;
            put_here(&places[g].tubes, i, here);
        }
    }
}

/* u at a place, and g. */
static void bend_at(const Unknowns *q, const Place *at, Real *u, Real *stretch) {
    const Real *in[5] = {at->direction, at->tubes.stiffness, at->tubes.moment, (const void *)q->tubes->offset, (const void *)q->tubes->angle};
    Real *out[2] = {u, stretch};
    section_curvature(in, out, 0, 0, 0);
}

/* A pose, R by columns and p, carried over a step of a length with u at its three points. */
static void carry_step(const Real *u, Real length, Real *pose) {
    Real next[12];
    const Real *in[3] = {pose, u, &length};
    Real *out[1] = {next};
    carry(in, out, 0, 0, 0);
    memcpy(pose, next, sizeof next);
}

/* Two poses carried over a piece: the first by all steps, where `each` gets it at the shape points, the other by one step
   for two, whose curvature lies on the polynomial through that of both: no curvature is evaluated for the error alone. */
static void carry_poses(const Unknowns *q, const Looks *at, const Place *places, Real length, Real *poses, Real *each) {
    Real u[12], stretch[N], rougher[6];
    for (int s = 0; s < at->steps; s++) {
        Real *own = u + s % 2 * 6;
        for (int g = 0; g < 3; g++) bend_at(q, places + 3 * s + g, own + 2 * g, stretch);
        carry_step(own, length / at->steps, poses);
        if ((s + 1) * STEPS % at->steps == 0) memcpy(each + ((s + 1) * STEPS / at->steps - 1) * 12, poses, 12 * sizeof(Real));
        if (s % 2 == 0) continue;
        memset(rougher, 0, sizeof rougher);
        for (int g = 0; g < 6; g++)
            for (int j = 0; j < 6; j++) rougher[j] += ROUGHER[j / 2 * 6 + g] * u[2 * g + j % 2];
        carry_step(rougher, 2 * length / at->steps, poses + 12);
    }
}

/* What a quadrature with more points, at `places`, says is wrong in phi, and the bending energy of the piece where none is
   known. */
static Real check_piece(const Unknowns *q, const Profile *arm, int p, const Place *places, Real *wrong) {
    const Layout *l = q->layout;
    Real h = q->length[p], bending, energy = {0}, stretch[N], moment[CHECK_DEGREE][N], rate[CHECK_DEGREE][N];
    int alone = !l->collocated[p] && l->across[p].steady; /* without torsion between tubes one point suffices */
    for (int k = 0; k < (alone ? 1 : CHECK_DEGREE); k++) {
        const Place *at = places + k;
        const Real *in[5] = {at->direction, at->tubes.stiffness, at->tubes.moment, (const void *)q->tubes->offset, (const void *)q->tubes->angle};
        Real *out[3] = {moment[k], stretch, &bending};
        section_moment(in, out, 0, 0, 0);
        energy += h * (alone ? 1 : CHECK_WEIGHTS[k]) * bending;
        for (int i = 0; i < N; i++) rate[k][i] = stretch[i] * at->tubes.rate[i];
    }
    for (int i = 0; i < N && !alone; i++) {
        Real turned[CHECK_DEGREE], torque[CHECK_DEGREE], worst = {0}, gained = {0};
        for (int k = 0; k < CHECK_DEGREE; k++) {
            torque[k] = arm->torque[p][i];
            turned[k] = arm->rotation[p][i];
        }
        for (int j = 0; j < CHECK_DEGREE; j++) {
            gained += h * CHECK_WEIGHTS[j] * moment[j][i];
            for (int k = 0; k < CHECK_DEGREE; k++) torque[k] += h * CHECK_COLUMNS[j * CHECK_DEGREE + k] * moment[j][i];
        }
        for (int j = 0; j < CHECK_DEGREE; j++)
            for (int k = 0; k < CHECK_DEGREE; k++)
                turned[k] += h * CHECK_COLUMNS[j * CHECK_DEGREE + k] * torque[j] * rate[j][i];
        for (int k = 0; k < CHECK_DEGREE; k++) worst = fmax(worst, fabs(turned[k] - places[k].phi[i]));
        for (int k = 0; k < MOST_DEGREE; k++) gained -= h * q->tableau->weights[k] * arm->moment[p][k * N + i];
        wrong[i] += worst + fabs(gained) * q->reach[p + 1][i];
    }
    return l->collocated[p] ? REAL(0.0) : energy;
}

/* One piece: its shape points into the answer, poses carried on, and what `check_piece` says. Returns the largest sum of |m|
   over that of kb at them. */
static Real add_piece(const Unknowns *q, const Profile *arm, int p, Real *poses, Real *wrong, Answers *out) {
    const Layout *l = q->layout;
    /* Where tubes do not vary along a piece, the curvature turns but as they are twisted. */
    const Looks *looks = l->across[p].steady ? &EVEN : &VARIED;
    const Place *ends;
    Real each[STEPS * 12], stretch[N], pull = {0};
    Place places[MOST_LOOKS];
    find_places(q, arm, p, looks, places);
    carry_poses(q, looks, places, q->length[p], poses, each);
    ends = places + 3 * looks->steps;
    for (int k = 0; k <= STEPS; k++) {
        int at = p * STEPS + k;
        Real total = {0}, stiff = {0};
        for (int i = 0; i < N; i++) {
            total += fabs(ends[k].tubes.moment[i]);
            stiff += ends[k].tubes.stiffness[i];
        }
        pull = fmax(pull, total / stiff);
        if (p && !k) continue;
        bend_at(q, ends + k, out->curvature[at], stretch);
        out->arc_length[at] = q->start[p] + q->length[p] * k / STEPS;
        for (int i = 0; i < N; i++) {
            Real torque = arm->torque[p][i];
            for (int j = 0; j < MOST_DEGREE; j++)
                torque += q->length[p] * looks->once[j * looks->count + 3 * looks->steps + k] * arm->moment[p][j * N + i];
            out->rotation[at][i] = ends[k].phi[i] + ends[k].tubes.twist_angle[i];
            out->torsion[at][i] = stretch[i] * torque * ends[k].tubes.rate[i] + twist_on(q->tubes, l, p, i, (double)k / STEPS);
        }
        if (!k) continue;
        const Real *here = each + (k - 1) * 12;
        for (int r = 0; r < 9; r++) out->frame[at][r] = here[3 * (r % 3) + r / 3];
        memcpy(out->position[at], here + 9, sizeof out->position[at]);
    }
    out->energy += check_piece(q, arm, p, ends + STEPS + 1, wrong);
    return pull;
}

static void tips_and_lever(const Unknowns *q, const Real *pulls, Answers *out, Real error) {
    const Layout *l = q->layout;
    int last = l->pieces * STEPS;
    Real lever = {0}, tip = out->arc_length[last];
    for (int p = 0; p < l->pieces; p++) {
        Real ahead = tip - q->start[p], h = q->length[p];
        lever += pulls[p] * h * (ahead - h / 2);
    }
    out->tip_error += error * lever;
    for (int i = 0; i < N; i++) {
        out->tube_end[i] = REAL(fmax(l->end[i], 0.0));
        out->tip_rotations[i] = out->rotation[ending(l, i) * STEPS][i];
    }
}

/* The one shape point of an arm of length zero. */
static void at_plate(const Unknowns *q, const Profile *arm, Answers *out) {
    out->arc_length[0] = REAL(0.0);
    memset(out->torsion[0], 0, sizeof out->torsion[0]);
    memset(out->curvature[0], 0, sizeof out->curvature[0]);
    memcpy(out->rotation[0], arm->rotation[0], sizeof out->rotation[0]);
    for (int i = 0; i < N; i++) out->rotation[0][i] += twist_angle_at(q->tubes->pieces, i, q->layout->transmission[i]);
}

/* Everything along the arm, and what mesh and steps get wrong; out->energy is that of the elements already. */
static void finish(const Unknowns *q, const State *state, const Profile *arm, Answers *out) {
    const Layout *l = q->layout;
    Real poses[24], wrong[N], error, pulls[MOST_PIECES];
    memset(poses, 0, sizeof poses);
    memset(wrong, 0, sizeof wrong);
    for (int k = 0; k < 24; k += 12) poses[k] = poses[k + 4] = poses[k + 8] = REAL(1.0);
    memset(out->position[0], 0, sizeof out->position[0]);
    memcpy(out->frame[0], poses, sizeof out->frame[0]);
    if (!l->pieces) at_plate(q, arm, out);
    out->elements = 0;
    for (int p = 0; p < l->pieces; p++) {
        pulls[p] = add_piece(q, arm, p, poses, wrong, out);
        out->elements += l->collocated[p];
    }
    error = largest(wrong, N) / fmax(fmin(REAL(1.0), fabs(out->margin)), REAL(1e-6));
    Real gap[3] = {poses[9] - poses[21], poses[10] - poses[22], poses[11] - poses[23]};
    out->mesh_error = error;
    out->tip_error = sqrt(dot(gap, gap, 3)) / SHAPE_RATIO;
    out->pieces = l->pieces;
    out->sections = l->sections;
    out->points = q->points;
    for (int k = 0; k < l->sections; k++) out->section_start[k] = REAL(l->section_start[k]);
    memcpy(out->point, q->s, q->points * sizeof(Real));
    memcpy(out->point_rotation, state->theta, q->points * sizeof(state->theta[0]));
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) out->point_rotation[x][i] += q->at[x].twist_angle[i];
    tips_and_lever(q, pulls, out, error);
}

#include "curve.c"
/* The place on the centreline of an arm at arc length s: behind the plate on its axis; the plate where the arm has no
   length. */
static void place_on(const Answer *a, double s, double *out) {
    int last = (int)a->pieces * STEPS;
    double inside = fmax(s, 0);
    memset(out, 0, 3 * sizeof(double));
    if (last) on_curve(a->arc_length, a->position, a->frame, piece_at(a->arc_length, last, inside), inside, out);
    out[2] += fmin(s, 0);
}
