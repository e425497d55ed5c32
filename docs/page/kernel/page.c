
#include <stdlib.h>

/* --- what the page asks: numbers go in by INPUT and come out by OUTPUT ---------------------------------------------- */

#define ASKED(name) __attribute__((export_name(#name)))
#define POINTS 65       /* of a centreline that is drawn */
#define FRAMES 400      /* of a snap at most */
#define GLIDE 0.12      /* rad, most that a frame of a snap turns any point */
#define MOST_OUTPUT (FRAMES * POINTS * 3)

static double INPUT[16 * N + 64], OUTPUT[MOST_OUTPUT];
static tubeopt_memory *arm;

ASKED(input) double *input(void) { return INPUT; }
ASKED(output) double *output(void) { return OUTPUT; }
ASKED(most_tubes) int most_tubes(void) { return N; }
ASKED(room) void *room(void) { return arm; }
ASKED(room_size) int room_size(void) { return (int)tubeopt_memory_size(); }
ASKED(own_size) int own_size(void) { return (int)sizeof(tubeopt_memory); }

static tubeopt_joints joints_in(void) {
    tubeopt_joints at;
    memcpy(&at, INPUT, sizeof at);
    return at;
}

/* The pose into OUTPUT, as the struct has it. */
static int pose_out(tubeopt_status status, const tubeopt_pose *pose) {
    if (status == TUBEOPT_DONE) memcpy(OUTPUT, pose, sizeof *pose);
    return status;
}

/* A robot of so many tubes, as Given in INPUT. The last arm is kept: it is where the search for the new one begins. */
ASKED(use) int use(int tubes) {
    if (tubes < 1 || tubes > N) return TUBEOPT_BAD_INPUT;
    if (!arm) {
        void *all = malloc(tubeopt_memory_size());
        if (!all) return TUBEOPT_TOO_LARGE;
        arm = tubeopt_start(all);
    }
    use_tubes(tubes, (const Given *)INPUT);
    arm->fresh = 0;
    arm->before = NULL;
    return TUBEOPT_DONE;
}

/* From tubes without torsion, as Python begins. */
ASKED(solve_cold) int solve_cold(void) {
    tubeopt_joints at = joints_in();
    tubeopt_pose pose;
    arm->bears = 0;
    return pose_out(tubeopt_solve(arm, &at, &pose), &pose);
}

/* The next equilibrium on the branch; 4 where that ends first. */
ASKED(follow) int follow(void) {
    tubeopt_joints at = joints_in();
    tubeopt_pose pose;
    return pose_out(tubeopt_follow(arm, &at, &pose), &pose);
}

/* A force on the tip (3) and gravity (3). */
ASKED(bear) int bear(void) {
    tubeopt_load load;
    tubeopt_pose pose;
    memcpy(&load, INPUT, sizeof load);
    return pose_out(tubeopt_bear(arm, &load, &pose), &pose);
}

/* One step of the tip towards a place: INPUT is a tubeopt_command up to its push. After the pose: distance, angle and reasons. */
ASKED(servo) int servo(void) {
    tubeopt_command command;
    tubeopt_pose pose;
    tubeopt_report report = {0};
    memset(&command, 0, sizeof command); /* no accelerations: a page has no drives */
    memcpy(&command, INPUT, offsetof(tubeopt_command, turn_acceleration));
    int status = pose_out(tubeopt_servo(arm, &command, &pose, &report), &pose);
    double *more = OUTPUT + sizeof pose / sizeof(double);
    more[0] = report.distance;
    more[1] = report.angle;
    more[2] = report.why;
    return status;
}

/* Positions (POINTS, 3) along the arm, and its length after them. */
ASKED(shape) int shape(void) {
    double s[POINTS];
    int status = tubeopt_shape(arm, POINTS, s, (double(*)[3])OUTPUT);
    OUTPUT[3 * POINTS] = s[POINTS - 1];
    return status;
}

/* Rotations (POINTS, N) of the tubes along the arm without load, and their number. */
ASKED(along) int along(void) {
    const Answer *a = arm->answers + arm->here;
    int last = (int)a->pieces * STEPS;
    for (int c = 0, k = 0; c < POINTS; c++) {
        double s = a->arc_length[last] * c / (POINTS - 1);
        while (k + 1 < last && a->arc_length[k + 1] < s) k++;
        double h = last ? a->arc_length[k + 1] - a->arc_length[k] : 1, t = last ? (s - a->arc_length[k]) / h : 0;
        for (int i = 0; i < N; i++)
            OUTPUT[c * N + i] = last ? (1 - t) * a->rotation[k][i] + t * a->rotation[k + 1][i] : a->rotation[0][i];
    }
    return POINTS;
}

/* --- a snap: descent in energy ----------------------------------------------------------------------------------- */

/* The arm of a state as one frame of a snap. */
static void draw(Workspace *w, const double *alpha, const State *state, Answer *scratch, int frame) {
    double(*out)[3] = (double(*)[3])(OUTPUT + 3 * POINTS * frame);
    integrate(&w->fine, alpha, state, &w->arm);
    scratch->margin = 1;
    scratch->energy = 0;
    finish(&w->fine, state, &w->arm, scratch);
    int last = (int)scratch->pieces * STEPS;
    for (int c = 0; c < POINTS; c++) {
        double s = scratch->arc_length[last] * c / (POINTS - 1);
        on_curve(scratch->arc_length, scratch->position, scratch->frame, piece_at(scratch->arc_length, last, s), s, out[c]);
    }
}

/* Theta of the last arm at joint values, its torsion kept, as unknowns. */
static int as_it_was(const tubeopt_joints *at, Workspace *w) {
    double theta[MOST_POINTS][N], turn[N];
    const Answer *last = arm->answers + arm->here;
    if (!lay_out(&ROBOT, at->translations, NULL, w->layout)) return 0;
    if (!pose_unknowns(&w->fine, w->layout, &ROBOT, &FINE, 0)) return 0;
    if (!pose_unknowns(&w->coarse, w->layout, &ROBOT, &COARSE, 0)) return 0;
    for (int i = 0; i < N; i++) turn[i] = at->rotations[i] - arm->joints.rotations[i];
    Guess guess = {last->pieces * STEPS + 1, last->points, 1, N, last->arc_length, last->rotation[0], last->torsion[0],
                   last->point, last->point_rotation[0], turn, arm->joints.translations};
    sample(&w->fine, &guess, 0, theta);
    to_unknowns(&w->fine, at->rotations, theta, w->state.z);
    return 1;
}

/* One step down in energy, at most GLIDE; 1 where the next minimum is reached. */
static int glide(Workspace *w, const double *alpha) {
    double step[MOST_UNKNOWNS];
    const Unknowns *q = &w->fine;
    int convex = downhill(q, &w->state, YES, &w->chain, step);
    double size = turn_of(q, step), scale = size > GLIDE ? GLIDE / size : 1;
    if (size <= COARSE_STEP && convex) return 1;
    if (size <= COARSE_STEP) { /* on a saddle: to either side */
        anywhere(step, q->size);
        scale = GLIDE / turn_of(q, step);
    }
    double before = w->state.energy, slope = dot(w->state.gradient, step, q->size);
    for (int half = 0; half < 40; half++, scale /= 2) {
        for (int r = 0; r < q->size; r++) w->trial.z[r] = w->state.z[r] + scale * step[r];
        evaluate(q, alpha, &w->trial);
        if (size <= COARSE_STEP || w->trial.energy <= before + 1e-4 * scale * slope + 1e-13 * fabs(before)) break;
    }
    w->state = w->trial;
    return 0;
}

/* Tubes twisted evenly from base to tip, at joint values and with the tip rotations behind them in INPUT, as unknowns. */
static int twisted_evenly(const tubeopt_joints *at, Workspace *w) {
    double theta[MOST_POINTS][N];
    const Unknowns *q = &w->fine;
    if (!lay_out(&ROBOT, at->translations, NULL, w->layout)) return 0;
    if (!pose_unknowns(&w->fine, w->layout, &ROBOT, &FINE, 0)) return 0;
    if (!pose_unknowns(&w->coarse, w->layout, &ROBOT, &COARSE, 0)) return 0;
    for (int x = 0; x < q->points; x++)
        for (int i = 0; i < N; i++) {
            double base = at->rotations[i], held = w->layout->transmission[i], whole = fmax(ROBOT.whole[i], 1e-9);
            theta[x][i] = base + (INPUT[2 * N + i] - base) * fmin((held + q->s[x]) / whole, 1);
        }
    to_unknowns(q, at->rotations, theta, w->state.z);
    return 1;
}

/* The arm let go: the pose of the next minimum of its energy, without load, which becomes the last one. It begins with the
   torsion of the last one, or where `evenly` with even twist. Frames on the way into OUTPUT; their number, 0 where no
   minimum was found. */
ASKED(let_go) int let_go(int evenly) {
    tubeopt_joints at = joints_in();
    Workspace *w = &arm->work;
    Answer *next = arm->answers + !arm->here;
    int frames = 0, iterations = 0, there = 0;
    arm->fresh = 0;
    arm->before = NULL;
    if (!evenly && !arm->started) return 0;
    if (!(evenly ? twisted_evenly(&at, w) : as_it_was(&at, w))) return 0;
    arm->bears = 0;
    evaluate(&w->fine, at.rotations, &w->state);
    while (!there && frames < FRAMES) {
        draw(w, at.rotations, &w->state, next, frames++);
        there = glide(w, at.rotations);
    }
    arm->ball.turn = 0;
    if (!there || newton(&w->fine, at.rotations, &w->state, &w->chain, MOST_ITERATIONS, &iterations, &next->contraction))
        return 0;
    judge(at.rotations, w, next);
    if (!(next->margin > 0)) return 0;
    next->iterations = iterations;
    finish(&w->fine, &w->state, &w->arm, next);
    accept(arm, &at);
    return frames;
}

/* The pose of the last equilibrium. */
ASKED(pose) int pose(void) {
    tubeopt_pose here;
    if (!arm->started) return TUBEOPT_NOT_STARTED;
    tell(arm, 0, &here);
    return pose_out(TUBEOPT_DONE, &here);
}

/* --- certificate and energy map ----------------------------------------------------------------------------------- */

#define LEAST_FACTOR 1e-6

/* The certificate of stability/certificate.py at the translations of INPUT: the least eigenvalue of the second variation
   with all curved tubes opposing each other. As a matrix with a Cholesky factor is needed, the coupling is made weaker by
   a factor until there is one; the eigenvectors stay. NAN where it cannot be computed. */
ASKED(certificate) double certificate(void) {
    tubeopt_joints at = joints_in();
    Workspace *w = &arm->work;
    const Unknowns *q = &w->fine;
    State *state = &w->state;
    arm->fresh = 0;
    arm->before = NULL;
    if (!lay_out(&ROBOT, at.translations, NULL, w->layout)) return NAN;
    if (!pose_unknowns(&w->fine, w->layout, &ROBOT, &FINE, 0)) return NAN;
    if (!q->size) return 1;
    for (double factor = 1; factor > LEAST_FACTOR; factor /= 2) {
        for (int x = 0; x < q->points; x++) {
            double sum = 0;
            for (int i = 0; i < N; i++) sum += q->at[x].stiffness[i];
            for (int i = 0; i < N; i++) {
                double *row = state->slope[x] + i * N;
                row[i] = 0;
                for (int j = 0; j < N; j++) {
                    if (j == i) continue;
                    row[j] = factor * fabs(q->at[x].moment[i] * q->at[x].moment[j]) / sum;
                    row[i] -= row[j];
                }
            }
        }
        double mode[MOST_UNKNOWNS];
        if (!factor_variation(q, state, 1, &w->chain)) continue;
        anywhere(mode, q->size);
        return 1 + (least_eigenvalue((Factored){q, &w->chain, NULL, NULL}, EIGENVALUE_ERROR, 0, 0, mode) - 1) / factor;
    }
    return NAN;
}

/* The tip of a tube: alpha + row . z + depth times a coordinate of its own, as stability/energy.py holds it. */
typedef struct {
    int tube, first, count;
    const double *row;
    double depth, twist;
} Hold;

static Hold hold_of(const Unknowns *q, int tube) {
    const Layout *l = q->layout;
    int p = 0;
    while (p < l->pieces && l->start[p] < l->end[tube] - ROUND_OFF_LENGTH) p++;
    Hold h = {tube, q->first[tube], q->count[tube], q->beyond + q->first[tube], 0, 0};
    h.depth = sqrt(fmax(q->reach[p][tube] - dot(h.row, h.row, h.count), 1e-30));
    return h;
}

/* Energy, gradient and the rest with both tips held; returns the energy. */
static double held(const Unknowns *q, const double *alpha, const Hold *holds, State *state) {
    evaluate(q, alpha, state);
    for (int k = 0; k < 2; k++) {
        const Hold *h = holds + k;
        double zeta = (h->twist - dot(h->row, state->z + h->first, h->count)) / h->depth;
        state->energy += zeta * zeta / 2;
        for (int a = 0; a < h->count; a++) state->gradient[h->first + a] -= h->row[a] * zeta / h->depth;
    }
    return state->energy;
}

/* Newton's method on it from state->z, as damped as `descend`; NAN where it does not end. */
static double held_minimum(const Unknowns *q, const double *alpha, const Hold *holds, Workspace *w) {
    double step[MOST_UNKNOWNS], springs[N] = {0}, energy = held(q, alpha, holds, &w->state);
    for (int k = 0; k < 2; k++) springs[holds[k].tube] = 1 / (holds[k].depth * holds[k].depth);
    for (int round = 0; round < 60; round++) {
        for (double shift = 0; shift < 1e6; shift = shift ? 4 * shift : 0.1)
            if (factor_held(q, &w->state, 1 + shift, springs, &w->chain)) break;
        for (int r = 0; r < q->size; r++) step[r] = -w->state.gradient[r];
        solve_variation(q, &w->chain, step);
        double size = turn_of(q, step), scale = size > LONGEST_STEP ? LONGEST_STEP / size : 1;
        double slope = dot(w->state.gradient, step, q->size);
        if (!isfinite(size)) return NAN;
        for (int half = 0; half < 40; half++, scale /= 2) {
            for (int r = 0; r < q->size; r++) w->trial.z[r] = w->state.z[r] + scale * step[r];
            if (held(q, alpha, holds, &w->trial) <= energy + 1e-4 * scale * slope + 1e-13 * fabs(energy)) break;
        }
        w->state = w->trial;
        energy = w->state.energy;
        if (size <= COARSE_STEP) return energy;
    }
    return NAN;
}

/* Least energy with the tips of tubes `one` and `two` held, at joint values of INPUT and in the window behind them (least and
   greatest angle of each, rad), on the coarse points, from point to point: (samples, samples) by the first; 0 where there
   is none, since the two do not act on one another. */
ASKED(energy_map) int energy_map(int one, int two, int samples) {
    tubeopt_joints at = joints_in();
    const double *window = INPUT + 2 * N;
    Workspace *w = &arm->work;
    Unknowns *q = &w->coarse;
    double row[MOST_UNKNOWNS] = {0};
    arm->fresh = 0;
    arm->before = NULL;
    if (!lay_out(&ROBOT, at.translations, NULL, w->layout)) return 0;
    if (!pose_unknowns(q, w->layout, &ROBOT, &COARSE, 0) || !q->count[one] || !q->count[two]) return 0;
    Hold holds[2] = {hold_of(q, one), hold_of(q, two)};
    for (int i = 0; i < samples; i++) {
        memcpy(w->state.z, row, q->size * sizeof(double));
        for (int j = 0; j < samples; j++) {
            holds[0].twist = window[0] + (window[1] - window[0]) * i / (samples - 1) - at.rotations[one];
            holds[1].twist = window[2] + (window[3] - window[2]) * j / (samples - 1) - at.rotations[two];
            OUTPUT[i * samples + j] = held_minimum(q, at.rotations, holds, w);
            if (j == 0) memcpy(row, w->state.z, q->size * sizeof(double));
        }
    }
    return 1;
}
