
/* --- servo ------------------------------------------------------------------------------------------------------- */

#define DAMPING 1e-3 /* of a joint's scale against the tip's way as a share of the robot's length */
#define HALVINGS 4   /* of a step that the guard does not let pass */
#define CLOSE 1e-9
#define ROOM 0.01  /* of the margin above its floor, at which the tip slides: a step along the floor bends away from it, */
#define ROOM_PER_STEP 20.0 /* and less where steps over the scales are shorter: the robot rests close to the floor */
#define RISE 0.3   /* share of what joints could do for margin or clearance that a step must do at most */
#define NEAR 1e-6  /* m and rad, at which a target is met */
#define DESCENT 0.25 /* fraction of the predicted decrease of the distance that a step must have: zigzags have none */
#define WIDER 4.   /* times the least snap distance, that is tried first where the tubes only turn */
#define BRAKINGS 5 /* times, as fractions of the braking time, at which the margin is checked */
#define MOST_CURVED 4. /* curvature of a distance over the scales: kinks, where breakpoints coincide, look larger */
#define MOST_STIFF 1e6
#define TRACKED 3. /* motions of the target in a cycle below which its distance is that of tracking it, without damping */
#define SEEN 1e-6  /* of a joint's scale: of a shorter whole step the curvature drowns in round-off */
#define SLOW 0.01  /* part of the decrease that is asked for, below which the next step solves for the whole distance */
#define DEAD 1e-7  /* of a joint's scale: a joint with a shorter whole step rests */
#define KEPT 1e-7  /* length (m) of a section that steps keep open where they keep the order of breakpoints */
#define GAIN 1e-9  /* of the longest tube: a whole step that brings the tip half as much closer leaves the robot at rest */

static const double BRAKING[BRAKINGS + 1] = {0, 0.13, 0.3, 0.5, 0.75, 1};

typedef struct {
    double task[6][JOINTS], missing[6], clipped; /* by independent joints over their scale; part of a step's speed */
    double tracked; /* distance from the target, over the longest tube, below which the robot tracks it */
    double margin[JOINTS], rate[JOINTS], low[JOINTS], high[JOINTS];
    double near[2][JOINTS]; /* ends of a step within rates, over the scale */
    int rows, why;
    int order, at_kink; /* number of the first row of the order of breakpoints; whether a step ends at one of these */
} Aim;

/* What the arm is to keep clear of. */
typedef struct {
    int count;
    double clearance;
#if TUBEOPT_BODIES
    tubeopt_contact *contacts;
#endif
} Bodies;

/* Derivatives (2 n) by rotations and translations, by independent joints over their scale. */
static void by_joints(const double *slope, double *out) {
    for (int c = 0; c < JOINTS; c++) {
        out[c] = 0;
        for (int k = 0; k < 2 * N; k++) out[c] += slope[k] * SPREAD[k * JOINTS + c];
        out[c] *= SCALE[c];
    }
}

static void dependent(const double *q, tubeopt_joints *joints) {
    for (int i = 0; i < N; i++) {
        double moved = OFFSET[N + i] + dot(SPREAD + (N + i) * JOINTS, q, JOINTS);
        joints->rotations[i] = OFFSET[i] + dot(SPREAD + i * JOINTS, q, JOINTS);
        joints->translations[i] = fmin(moved, ROBOT.straight[i]);
    }
}

/* What is missing to the command (6) at the last or the next equilibrium: position over the longest tube, direction. */
static int missing_to(const tubeopt_memory *m, const tubeopt_command *c, int next, double *missing, double *t) {
    tubeopt_pose pose;
    double length = sqrt(dot(c->direction, c->direction, 3));
    tell(m, next, &pose);
    for (int r = 0; r < 3; r++) {
        t[r] = pose.frame[3 * r + 2];
        missing[r] = (c->position[r] - pose.position[r]) / LONGEST_TUBE;
        missing[3 + r] = length > 0 ? c->direction[r] / length - t[r] : 0;
    }
    return length > 0 ? 6 : 3;
}

static void report_missing(const tubeopt_memory *m, const tubeopt_command *c, tubeopt_report *report) {
    double missing[6], t[3];
    missing_to(m, c, 0, missing, t);
    report->distance = LONGEST_TUBE * sqrt(dot(missing, missing, 3));
    report->angle = 2 * asin(fmin(1, sqrt(dot(missing + 3, missing + 3, 3)) / 2));
}

/* Whether a velocity is commanded, which has no distance that steps reduce. */
static int led(const tubeopt_command *c) { return dot(c->velocity, c->velocity, 3) > 0; }

/* What is missing to the command, and how the tip answers to the joints. */
static void aim_at(const tubeopt_memory *m, const tubeopt_command *c, Aim *aim) {
    double t[3];
    aim->rows = missing_to(m, c, 0, aim->missing, t);
    for (int r = 0; r < 3; r++) {
        int one = (r + 1) % 3, two = (r + 2) % 3;
        double first[JOINTS], second[JOINTS];
        by_joints(m->slopes.position[r], aim->task[r]);
        by_joints(m->slopes.turn[one], first);
        by_joints(m->slopes.turn[two], second);
        for (int k = 0; k < JOINTS; k++) { /* the change of the direction t is turn x t */
            aim->task[r][k] /= LONGEST_TUBE;
            aim->task[3 + r][k] = first[k] * t[two] - second[k] * t[one];
        }
    }
    by_joints(m->slopes.margin, aim->margin);
}

/* The largest part of a motion of the tip (6) that its speed allows: a direction turns as fast as the tip would about a
   tenth of the robot. */
static double part_allowed(const tubeopt_command *c, const double *motion, int kind) {
    double most = c->speed * c->step / (kind ? LONGEST_TUBE / 10 : LONGEST_TUBE), size = sqrt(dot(motion + 3 * kind, motion + 3 * kind, 3));
    return size > most ? most / size : 1;
}

/* Room for one row more, whose bound is known. */
static double *new_row(Quadratic *p, double bound) {
    p->bounds[p->count] = bound;
    return p->rows + JOINTS * p->count++;
}

#if TUBEOPT_BODIES
#include "contacts.c"
#else
#define keep_clear(memory, bodies, rise, program, aim) (void)(bodies)
#define too_close(memory, bodies) 0
#define shift_contacts(memory, stop, bodies)
#endif

/* Whether snap distances count in place of margins. */
static int sees_snaps(const tubeopt_command *c) {
    return SLOPES && N <= 4 && c->min_snap_distance > 0;
}

/* Whether the robot may stop at joint values, whose equilibrium was solved last: far enough from a snap, which a ball proves, or
   with a margin above the floor. At a start closer to a snap it may also stop where the margin is not smaller. */
static int may_stop(tubeopt_memory *m, const tubeopt_command *c, double floor, const tubeopt_joints *at, Ball *ball) {
    double r = c->min_snap_distance;
    *ball = m->ball;
    if (!sees_snaps(c)) return stated_margin(m, 1) >= floor;
    if (turn_left(ball, at) >= r) return 1;
#if SLOPES
    if (couple(m)) {
        int turns = !memcmp(at->translations, m->joints.translations, sizeof at->translations);
        double proved = never_snaps(m) ? INFINITY : turns && proves(m, WIDER * r) ? WIDER * r : proves(m, r) ? r : 0;
        if (proved > 0) *ball = (Ball){*at, proved, bears(m)};
        return proved > 0 || (turn_left(&m->ball, &m->joints) < r && stated_margin(m, 1) >= stated_margin(m, 0));
    }
#endif
    return stated_margin(m, 1) >= floor;
}

/* Rows of a step that keeps the order of breakpoints along the arm: sections between them do not close. */
static void keep_order(const double *q, Quadratic *p) {
    double at[BREAKS + 1] = {0};
    int carriage[BREAKS + 1] = {-1}, count = 1; /* the first is the plate */
    for (int b = 0; b < BREAKS; b++) {
        double s = q[N + BREAK_CARRIAGE[b]] + BREAK_AT[b];
        int k = count;
        if (s <= 0) { /* behind the plate: it stays there */
            double *row = new_row(p, fmin(KEPT + s, 0));
            memset(row, 0, JOINTS * sizeof(double));
            row[N + BREAK_CARRIAGE[b]] = -SCALE[N + BREAK_CARRIAGE[b]];
            continue;
        }
        for (; k > 1 && at[k - 1] > s; k--) at[k] = at[k - 1], carriage[k] = carriage[k - 1];
        at[k] = s;
        carriage[k] = BREAK_CARRIAGE[b];
        count++;
    }
    for (int k = 1; k < count; k++) {
        if (carriage[k] == carriage[k - 1]) continue;
        double *row = new_row(p, fmin(KEPT - (at[k] - at[k - 1]), 0));
        memset(row, 0, JOINTS * sizeof(double));
        row[N + carriage[k]] = SCALE[N + carriage[k]];
        if (carriage[k - 1] >= 0) row[N + carriage[k - 1]] = -SCALE[N + carriage[k - 1]];
    }
}

/* Rows of a step over the joints' scale: rates and ranges, order, floor of the margin, which it need not raise by more
   than `rise`; where that is 0, to stay keeps them all. */
static void hedge(const tubeopt_memory *m, const tubeopt_command *c, const Bodies *bodies, const double *q, double rise,
                  Quadratic *p, Aim *aim) {
    p->count = 0;
    for (int k = 0; k < JOINTS; k++) {
        double most = k < N ? LARGEST_TURN : LARGEST_SHIFT * LONGEST_TUBE, low = fmax(-most, m->low[k]), high = fmin(most, m->high[k]);
        aim->near[0][k] = low / SCALE[k];
        aim->near[1][k] = high / SCALE[k];
        if (m->damping) { /* this step is shortened as a whole, once it is known; a joint that moves brakes before it returns */
            double brakes = 0.51 * (k < N ? c->turn_acceleration : c->shift_acceleration) * c->step * c->step;
            low = low < -brakes ? -most : 0;
            high = high > brakes ? most : 0;
        }
        aim->rate[k] = fmax(high, -low) / SCALE[k];
        aim->low[k] = fmin(0, fmax(low, LOWER[k] - q[k])) / SCALE[k];
        aim->high[k] = fmax(0, fmin(high, UPPER[k] - q[k])) / SCALE[k];
        for (int side = 0; side < 2; side++) {
            double *row = new_row(p, side ? -aim->high[k] : aim->low[k]);
            memset(row, 0, JOINTS * sizeof(double));
            row[k] = side ? -1 : 1;
        }
    }
    for (int r = 0; r < ORDERS; r++) {
        double *row = new_row(p, fmin(LEAST[r] - dot(ORDER + r * JOINTS, q, JOINTS), 0));
        for (int k = 0; k < JOINTS; k++) row[k] = ORDER[r * JOINTS + k] * SCALE[k];
    }
    double most = 0;
    for (int k = 0; k < JOINTS; k++) most += fmax(aim->margin[k] * aim->low[k], aim->margin[k] * aim->high[k]);
    double least = sees_snaps(c) ? m->wall : c->min_margin;
    double room = fmin(ROOM, ROOM_PER_STEP * sqrt(dot(m->last, m->last, JOINTS)));
    double raised = fmin(fmin(0.5 * (least + room - stated_margin(m, 0)), RISE * most), rise);
    memcpy(new_row(p, raised), aim->margin, sizeof aim->margin);
    keep_clear(m, bodies, rise, p, aim);
    aim->order = p->count;
    if (m->ordered) keep_order(q, p);
}

/* The step (n) over the joints' scale that brings the tip closest, in least squares with a little damping, and within
   what that leaves free towards a larger margin. 0 where there is none. */
static int step_towards(tubeopt_memory *m, const tubeopt_command *c, const Bodies *bodies, const double *q, double rise,
                        Aim *aim, double *step) {
    double matrix[(6 + JOINTS) * JOINTS], right[6 + JOINTS];
    Quadratic p = {m->rows, m->bounds, m->multipliers, JOINTS, 0, {0}, 0};
    hedge(m, c, bodies, q, rise, &p, aim);
    double steep = sqrt(dot(aim->margin, aim->margin, JOINTS)), push = steep > 0 ? c->push * c->turn_rate * c->step / steep : 0;
    double share = 1;
    memset(matrix, 0, sizeof matrix);
    memcpy(matrix, aim->task, aim->rows * sizeof aim->task[0]);
    for (int r = 0; r < aim->rows; r++) right[r] = (m->damping ? 1 : part_allowed(c, aim->missing, r / 3)) * aim->missing[r];
    for (int k = 0, r = aim->rows; k < JOINTS; k++, r++) {
        matrix[r * JOINTS + k] = sqrt(DAMPING * DAMPING + m->damping * m->stiff[k]);
        right[r] = m->damping ? 0 : DAMPING * m->ease * push * aim->margin[k];
    }
    if (!least_squares(&p, aim->rows + JOINTS, matrix, right, step)) return 0;
    if (m->damping) {
        double motion[6];
        for (int r = 0; r < 6; r++) motion[r] = dot(aim->task[r], step, JOINTS);
        for (int kind = 0; kind < aim->rows / 3; kind++) share = fmin(share, part_allowed(c, motion, kind));
        for (int k = 0; k < JOINTS; k++)
            if (step[k]) share = fmin(share, fmax(0, aim->near[step[k] > 0][k] / step[k]));
    }
    aim->clipped = share;
    aim->why = aim->at_kink = 0;
    for (int k = 0; k < p.actives; k++) {
        int r = p.active[k], joint = r / 2;
        if (r >= aim->order)
            aim->at_kink = 1;
        else if (r >= 2 * JOINTS)
            aim->why |= r < 2 * JOINTS + ORDERS ? TUBEOPT_AT_ORDER : r == 2 * JOINTS + ORDERS ? TUBEOPT_AT_MARGIN : TUBEOPT_AT_BODY;
        else {
            double end = r % 2 ? UPPER[joint] - q[joint] : q[joint] - LOWER[joint], used = fabs(step[joint]) * SCALE[joint];
            aim->why |= end <= used + CLOSE ? TUBEOPT_AT_RANGE : TUBEOPT_AT_RATE;
        }
    }
    return 1;
}

static tubeopt_status not_commanded(const tubeopt_command *c) {
    const double *all = (const double *)c;
    int possible = c->step > 0 && c->speed >= 0 && c->turn_rate >= 0 && c->shift_rate >= 0 && c->push >= 0;
    possible &= c->closest >= 0;
    if (!possible || fmin(fmin(c->turn_acceleration, c->shift_acceleration), c->min_snap_distance) < 0) return TUBEOPT_BAD_INPUT;
    tubeopt_status found = bounded(all, sizeof *c / sizeof *all, TUBEOPT_MOST_NUMBER);
    int away = sqrt(dot(c->position, c->position, 3)) > TUBEOPT_MOST_AWAY * LONGEST_TUBE;
    return found == TUBEOPT_DONE && away ? TUBEOPT_TOO_LARGE : found;
}

/* Where a robot that follows its stop point s is after a time T, and how fast it went there. */
static void follow_stop(const tubeopt_command *c, const double *s, double T, double *q, double *speed) {
    for (int k = 0; k < JOINTS; k++) {
        double a = k < N ? c->turn_acceleration : c->shift_acceleration, d = s[k] - q[k];
        speed[k] = a > 0 ? 2 * d / (T + sqrt(T * T + 2 * fabs(d) / a)) : d / T;
        q[k] = a > 0 ? q[k] + T * speed[k] : s[k];
    }
}

/* How a robot goes in a cycle from one place to the next, and how it brakes from there, with its speed, to a stop point. */
typedef struct {
    double from[JOINTS], q[JOINTS], speed[JOINTS], stop[JOINTS];
} Way;

/* Where it is at a time: before 0 a part of the cycle is left, then it is part of that for which it brakes. */
static void place_of(const tubeopt_command *c, const Way *w, double time, double *at) {
    double longest = 0;
    for (int k = 0; time > 0 && k < JOINTS; k++) longest = fmax(longest, fabs(w->speed[k]) / (k < N ? c->turn_acceleration : c->shift_acceleration));
    for (int k = 0; k < JOINTS; k++) {
        double q = w->q[k], left = 1;
        if (time > 0 && w->speed[k]) left = fmax(0, 1 - time * longest * (k < N ? c->turn_acceleration : c->shift_acceleration) / fabs(w->speed[k]));
        at[k] = time > 0 ? w->stop[k] - (w->stop[k] - q) * left * left : q + time * (q - w->from[k]);
    }
}

/* The margin there; -1 where none is found. */
static double margin_on(tubeopt_memory *robot, const tubeopt_command *c, const Way *w, double time) {
    double at[JOINTS];
    tubeopt_joints next;
    place_of(c, w, time, at);
    dependent(at, &next);
    return step_to(robot, &next) || bear_to(robot, &next, 1) ? -1 : stated_margin(robot, 1);
}

/* Whether breakpoints meet each other, or the plate, between two places. */
static int breakpoints_meet(const double *from, const double *to) {
    double gap[2];
    for (int a = 0; a < BREAKS; a++)
        for (int b = -1; b < a; b++) {
            for (int k = 0; k < 2; k++) {
                const double *q = (k ? to : from) + N;
                gap[k] = q[BREAK_CARRIAGE[a]] + BREAK_AT[a] - (b < 0 ? 0 : q[BREAK_CARRIAGE[b]] + BREAK_AT[b]);
            }
            if ((gap[0] < -KEPT && gap[1] > KEPT) || (gap[0] > KEPT && gap[1] < -KEPT)) return 1;
        }
    return 0;
}

/* Whether the margin keeps a floor where breakpoints meet between two times. There it has kinks, and falls steeply towards them: the
   robot can snap there, between two places with margins above the floor. */
static int keeps_at_kinks(tubeopt_memory *robot, const tubeopt_command *c, const Way *w, double floor, double from, double to) {
    double one[JOINTS], two[JOINTS];
    place_of(c, w, to, two);
    for (int kinks = 0; kinks <= BREAKS; kinks++) {
        double low = from, high = to;
        place_of(c, w, from, one);
        if (!breakpoints_meet(one, two)) return 1;
        for (int half = 0; half < 20; half++) {
            double middle = (low + high) / 2, place[JOINTS];
            place_of(c, w, middle, place);
            if (breakpoints_meet(one, place))
                high = middle;
            else
                low = middle;
        }
        if (margin_on(robot, c, w, high) < floor) return 0;
        from = high;
    }
    return 0;
}

#if SLOPES
/* Whether nothing can snap between a stop point, solved last, the one before and the robot, in any order of their joints: 1 or 0.
   Then robot and stop point are on one branch, as before. -1 where slides are not known, as of tubes made of pieces. */
static int proves_way(tubeopt_memory *m, const tubeopt_joints *stop, const tubeopt_joints *robot) {
    double slide[2][N], low = 0, high = 0, by[N];
    Workspace *w = &m->work;
    Guess guess = guess_of(m->answers + !m->here, NULL, stop->translations);
    for (int i = 0; i < N; i++) {
        const tubeopt_joints *ends[2] = {&m->joints, robot};
        slide[0][i] = slide[1][i] = 0;
        for (int k = 0; k < 2; k++) {
            double turn = ends[k]->rotations[i] - stop->rotations[i], shift = ends[k]->translations[i] - stop->translations[i];
            low = fmin(low, turn), high = fmax(high, turn);
            slide[0][i] = fmin(slide[0][i], shift), slide[1][i] = fmax(slide[1][i], shift);
        }
    }
    for (int sides = 0; sides < 1 << N; sides++) {
        int other = 0, found;
        for (int i = 0; i < N; i++) {
            int side = sides >> i & 1;
            by[i] = slide[side][i];
            other |= !by[i] && (side || slide[1][i]); /* of a tube that slides one way, or none, that way only */
        }
        if (other) continue;
        found = find_slides(&ROBOT, stop->rotations, stop->translations, by, &guess, &w->slides, &w->trial, &w->chain, &w->couplings);
        if (found < 0) return -1;
        if (!found || !proves_turn(&w->couplings, (high - low) / 2)) return 0;
    }
    return 1;
}
#endif

/* Whether a robot can follow a stop point s: in a ball about s, or where its way there is proved, it can. Where slides are not known, the next
   place, some on the way on which it brakes to s, and those where breakpoints meet keep a margin. Where the least of them, or that at
   `rest`, is close to the floor, there are two more places about it. */
static int can_brake(tubeopt_memory *robot, tubeopt_memory *m, const tubeopt_joints *stop, const tubeopt_command *c, const Ball *ball, const double *s,
                     double floor, double rest) {
    double least = rest;
    int at = BRAKINGS;
    Way way;
    if (sees_snaps(c) && turn_left(ball, &robot->joints) > 0) return 1;
#if SLOPES
    int proved = sees_snaps(c) && !bears(m) ? proves_way(m, stop, &robot->joints) : -1;
    if (proved >= 0) return proved;
#endif
    independent(&robot->joints, way.from);
    memcpy(way.q, way.from, sizeof way.q);
    memcpy(way.stop, s, sizeof way.stop);
    follow_stop(c, s, c->step, way.q, way.speed);
    if (!keeps_at_kinks(robot, c, &way, floor, -1, 0)) return 0;
    for (int k = 0; k < BRAKINGS; k++) {
        double found = margin_on(robot, c, &way, BRAKING[k]);
        if (found < floor || !keeps_at_kinks(robot, c, &way, floor, BRAKING[k], BRAKING[k + 1])) return 0;
        if (found < least) at = k;
        least = fmin(least, found);
    }
    if (least >= floor + 4 * ROOM) return 1;
    return (at == 0 || margin_on(robot, c, &way, (BRAKING[at - 1] + BRAKING[at]) / 2) >= floor) &&
           (at == BRAKINGS || margin_on(robot, c, &way, (BRAKING[at] + BRAKING[at + 1]) / 2) >= floor);
}

/* The squared distance after a share of a step, as the linear model has it. */
static double distance_after(const Aim *aim, const double *step, double share) {
    double sum = 0;
    for (int r = 0; r < aim->rows; r++) {
        double left = aim->missing[r] - share * dot(aim->task[r], step, JOINTS);
        sum += left * left;
    }
    return sum;
}

/* Leave joints at their place that a step (n) over the scales moves by less than DEAD: they do not tremble while others move. The
   step stays as it is where that would break the order of the tubes, as of two that slide together at about DEAD. */
static void rest_of(const double *q, double *step) {
    double still[JOINTS];
    for (int k = 0; k < JOINTS; k++) still[k] = fabs(step[k]) < DEAD ? 0 : step[k];
    for (int r = 0; r < ORDERS; r++) {
        const double *row = ORDER + r * JOINTS;
        double moved = 0, after = 0;
        for (int k = 0; k < JOINTS; k++) moved += row[k] * SCALE[k] * step[k], after += row[k] * SCALE[k] * still[k];
        if (after < moved && after < fmin(LEAST[r] - dot(row, q, JOINTS), 0)) return;
    }
    memcpy(step, still, sizeof still);
}

/* Take so much of a step (n) over the joints' scale as the guard lets pass and brings the tip closer; returns why it is not all.
   The damping follows the curvature of the distance: what is out of reach is missed by Gauss-Newton steps, each farther. */
static int take(tubeopt_memory *m, tubeopt_memory *robot, const tubeopt_command *c, const Bodies *bodies, const double *q, double *step, double floor,
                Aim *aim, tubeopt_report *report) {
    tubeopt_joints next;
    Ball ball;
    double share = aim->clipped, size = 0, turned = 0, there[JOINTS], left[6], t[3];
    double asked = fmin(part_allowed(c, aim->missing, 0), part_allowed(c, aim->missing, 1)); /* part of what is missing */
    int guarded = 0, back = 0, far = !m->damping && asked < 1;
    for (int k = 0; k < JOINTS; k++) step[k] = fmin(fmax(step[k], aim->low[k]), aim->high[k]); /* of rounding */
    if (m->damping) rest_of(q, step);
    for (int k = 0; k < JOINTS; k++) {
        size = fmax(size, fabs(step[k]));
        turned += step[k] * m->last[k];
        m->stiff[k] = !m->damping ? 1 : step[k] * m->last[k] < 0 ? fmin(4 * m->stiff[k], MOST_STIFF) : fmax(1, m->stiff[k] / 1.2);
        back |= far && share * step[k] * m->last[k] < -0.5 * m->last[k] * m->last[k] && fabs(m->last[k]) > 10 * DEAD;
    }
    back |= m->damping && turned < -0.5 * sqrt(dot(step, step, JOINTS) * dot(m->last, m->last, JOINTS));
    double before = led(c) ? 0 : dot(aim->missing, aim->missing, 6), whole = distance_after(aim, step, 1);
    if ((m->damping && before - whole < GAIN * sqrt(before)) || share * size < DEAD * DEAD) return aim->why & ~TUBEOPT_AT_RATE;
    for (int half = 0; half <= HALVINGS; half++, share /= 2) {
        double ends = 0, model = distance_after(aim, step, share), after, curved;
        for (int k = 0; k < JOINTS; k++)
            there[k] = fmin(fmax(q[k] + share * SCALE[k] * step[k], fmin(q[k], LOWER[k])), fmax(q[k], UPPER[k]));
        dependent(there, &next);
        report->solves++;
        Way way;
        memcpy(way.from, q, sizeof way.from);
        memcpy(way.q, there, sizeof way.q);
        if (robot == m && !keeps_at_kinks(m, c, &way, sees_snaps(c) ? 0 : floor, -1, 0)) {
            guarded = 1;
            continue;
        }
        if (step_to(m, &next) || bear_to(m, &next, 1) || too_close(m, bodies) || !may_stop(m, c, floor, &next, &ball)) {
            guarded = 1;
            continue;
        }
        missing_to(m, c, 1, left, t);
        after = dot(left, left, 6);
        ends = share * share * dot(step, step, JOINTS);
        int seen = ends > SEEN * SEEN;
        curved = seen ? fmin((after - model) / ends, MOST_CURVED) : 0;
        int closer = before < aim->tracked * aim->tracked || model >= before || before < DEAD * DEAD || before - after >= DESCENT * (before - model);
        int slow = far && !(aim->why & TUBEOPT_AT_RATE) && before - after < SLOW * asked * before;
        if (!closer || back || slow || (m->damping && curved > m->damping)) m->damping = fmax(fmax(curved, fmin(4 * m->damping * (!closer || back), MOST_CURVED)), DAMPING * DAMPING);
        else if (m->damping && share == 1 && seen) m->damping = m->damping > 2 * DAMPING * DAMPING ? fmax(curved, m->damping / 2) : 0;
        if (!closer) continue;
        if (robot != m && !can_brake(robot, m, &next, c, &ball, there, fmin(fmin(floor + ROOM / 2, stated_margin(robot, 0)), stated_margin(m, 1)), stated_margin(m, 1))) {
            guarded = 1;
            continue;
        }
        if (m->damping && share < 1 && ++m->damped >= m->patience) { /* far from rest: perhaps it does without again */
            m->damping = m->damped = 0;
            m->patience *= 2;
        }
        m->wall = guarded ? stated_margin(m, 0) : aim->why & TUBEOPT_AT_MARGIN ? m->wall : 0;
        m->ball = ball;
        accept(m, &next);
        accept_loaded(m);
        m->ease = fmin(1, (turned < 0 ? 0.5 : 1.2) * m->ease);
        for (int k = 0; k < JOINTS; k++)
            if (step[k]) m->last[k] = share * step[k];
        return aim->why | (guarded ? TUBEOPT_SHORTENED : 0);
    }
    if (guarded) m->damping = 0, m->wall = stated_margin(m, 0); /* another direction may pass */
    return guarded ? TUBEOPT_HELD : aim->why & ~TUBEOPT_AT_RATE;
}

/* The step (n) over the joints' scale straight to joint values, as much of it as rates allow. */
static void straight_to(tubeopt_memory *m, const tubeopt_joints *goal, const double *q, Aim *aim, double *step) {
    double to[JOINTS];
    memset(aim, 0, sizeof *aim);
    independent(goal, to);
    aim->clipped = 1;
    m->damping = 0;
    for (int k = 0; k < JOINTS; k++) {
        double most = k < N ? LARGEST_TURN : LARGEST_SHIFT * LONGEST_TUBE, end = to[k] > q[k] ? fmin(m->high[k], most) : fmax(m->low[k], -most);
        step[k] = aim->low[k] = aim->high[k] = (to[k] - q[k]) / SCALE[k];
        if (to[k] != q[k]) aim->clipped = fmin(aim->clipped, fmax(0, end / (to[k] - q[k])));
    }
    aim->why = aim->clipped < 1 ? TUBEOPT_AT_RATE : 0;
}

/* Keep the order of breakpoints after a step that brings the tip no closer, and release it where it is not needed. Where breakpoints
   coincide the distance has kinks: a step across one may not descend although another step on this side does. At rest on this side, a
   step across is tried again. */
static void choose_order(tubeopt_memory *m, int rests, int no_closer, int at_kink) {
    if (!m->ordered) {
        m->ordered = no_closer;
        m->progress = 0;
    } else if (rests ? m->progress : !at_kink)
        m->ordered = 0;
    m->progress |= !rests;
}

static tubeopt_status servo_step(tubeopt_memory *m, tubeopt_memory *robot, const tubeopt_command *c, const tubeopt_joints *goal,
                                 const Bodies *bodies, tubeopt_pose *pose, tubeopt_report *report) {
    Aim aim;
    tubeopt_joints next;
    double q[JOINTS], step[JOINTS] = {0}, floor, moved = 0;
    independent(&m->joints, q); /* which has one translation for all tubes without play between them */
    dependent(q, &next);
    for (int i = 0; i < N; i++)
        if (fabs(next.translations[i] - m->joints.translations[i]) > CLOSE) return TUBEOPT_BAD_INPUT;
    report->solves = 0;
    report->why = TUBEOPT_HELD;
    if (!goal && look_ahead(m, 0)) return TUBEOPT_DECLINED;
    const Answer *here = m->answers + m->here;
    m->origin = m->joints;
    keep_loaded(m);
    if (!goal) aim_at(m, c, &aim);
    report_missing(m, c, report);
    for (int r = 0; r < 3; r++) moved += (c->position[r] - m->goal[r]) * (c->position[r] - m->goal[r]);
    int another = led(c) || sqrt(moved) > 2 * c->speed * c->step;
    aim.tracked = another || goal ? 0 : TRACKED * sqrt(moved) / LONGEST_TUBE;
    if (another) {
        m->damping = m->damped = 0;
        m->patience = PATIENCE;
        m->ordered = 0;
    }
    memcpy(m->goal, c->position, sizeof m->goal);
    floor = fmin(c->min_margin, stated_margin(m, 0)); /* what is below it does not get worse */
    if (goal) straight_to(m, goal, q, &aim, step);
    if (goal || step_towards(m, c, bodies, q, 1, &aim, step) || step_towards(m, c, bodies, q, 0, &aim, step))
        report->why = take(m, robot, c, bodies, q, step, floor, &aim, report);
    int rests = !memcmp(&m->origin, &m->joints, sizeof next), missed = fmax(report->distance, report->angle) > NEAR;
    if (rests && missed && !goal && !(report->why & TUBEOPT_HELD)) report->why |= TUBEOPT_NO_CLOSER;
    choose_order(m, rests, report->why & TUBEOPT_NO_CLOSER, aim.at_kink);
    m->before = here;
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}

/* The robot follows its stop point s, where it would rest if it braked from now on: s = q + v |v| / (2 a). The step above is one
   of s, within what a changes v by in a cycle; then v = sgn(d) (sqrt((a T)^2 + 2 a |d|) - a T), d = s - q, ends in s again. So the
   robot can always brake before what s keeps clear of: ranges, order, and the floor of the margin. */
static tubeopt_status servo_towards(tubeopt_memory *m, const tubeopt_command *c, const tubeopt_joints *goal, Bodies *bodies, tubeopt_pose *pose,
                            tubeopt_report *report) {
    tubeopt_memory *stop = m;
    tubeopt_joints next;
    tubeopt_command ahead;
    double q[JOINTS], s[JOINTS], T = c->step;
    tubeopt_status not_taken = m->started ? not_commanded(c) : TUBEOPT_NOT_STARTED;
    if (not_taken) return not_taken;
    int limited = c->turn_acceleration > 0 || c->shift_acceleration > 0;
    if (limited) stop = stop_of(m);
    if (limited && !m->moves) {
        memcpy(stop, m, ROOM_OF_ONE);
        stop->fresh = 0; /* the workspace points to what was copied */
        memset(m->speed, 0, sizeof m->speed);
    }
    m->moves = limited;
    m->was_moving = 0;
    independent(&m->joints, q);
    independent(&stop->joints, s);
    for (int k = 0; k < JOINTS; k++) {
        double a = k < N ? c->turn_acceleration : c->shift_acceleration, rate = k < N ? c->turn_rate : c->shift_rate;
        double inverse = a > 0 ? 1 / a : 0, more = a > 0 ? a * T : INFINITY, v = limited ? m->speed[k] : 0;
        double fast = fmin(v + more, fmax(rate, v - more)), slow = fmax(v - more, fmin(-rate, v + more));
        stop->low[k] = slow * T + inverse * slow * fabs(slow) / 2 - (s[k] - q[k]);
        stop->high[k] = fast * T + inverse * fast * fabs(fast) / 2 - (s[k] - q[k]);
    }
    if (led(c)) { /* the place to which a velocity leads the stop point in a cycle */
        tubeopt_pose from;
        double size = sqrt(dot(c->velocity, c->velocity, 3));
        tell(stop, 0, &from);
        ahead = *c;
        for (int r = 0; r < 3; r++) ahead.position[r] = from.position[r] + T * fmin(1, c->speed / size) * c->velocity[r];
        c = &ahead;
    }
    shift_contacts(m, stop, bodies);
    tubeopt_status status = servo_step(stop, m, c, goal, bodies, pose, report);
    if (status || !limited) return status;
    report_missing(m, c, report);
    m->was_moving = 1;
    memcpy(m->slower, m->speed, sizeof m->speed);
    independent(&stop->joints, s);
    follow_stop(c, s, T, q, m->speed);
    dependent(q, &next);
    if (keep_branch(m, &next, 1)) { /* which s has kept: it does not happen */
        m->moves = 0;
        report->why |= TUBEOPT_HELD;
    }
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}

#include "seek.c"

tubeopt_status tubeopt_servo(tubeopt_memory *m, const tubeopt_command *c, tubeopt_pose *pose, tubeopt_report *report) {
    Bodies none = {0};
    return c->closest > 0 && !led(c) ? servo_closest(m, c, pose, report) : servo_towards(m, c, NULL, &none, pose, report);
}

tubeopt_status tubeopt_servo_joints(tubeopt_memory *m, const tubeopt_command *c, const tubeopt_joints *goal, tubeopt_pose *pose,
                                    tubeopt_report *report) {
    Bodies none = {0};
    double q[JOINTS];
    tubeopt_status not_taken = refused(goal);
    independent(goal, q);
    for (int k = 0; k < JOINTS && !not_taken; k++)
        if (q[k] < LOWER[k] - CLOSE || q[k] > UPPER[k] + CLOSE) not_taken = TUBEOPT_BAD_INPUT;
    for (int r = 0; r < ORDERS && !not_taken; r++)
        if (dot(ORDER + r * JOINTS, q, JOINTS) < LEAST[r] - CLOSE) not_taken = TUBEOPT_BAD_INPUT;
    return not_taken ? not_taken : servo_towards(m, c, goal, &none, pose, report);
}

#if TUBEOPT_BODIES
tubeopt_status tubeopt_servo_among(tubeopt_memory *m, const tubeopt_command *c, int count,
                                   const tubeopt_contact *contacts, double clearance, tubeopt_pose *pose,
                                   tubeopt_report *report) {
    tubeopt_contact own[TUBEOPT_MOST_CONTACTS];
    Bodies bodies = {count, clearance, own};
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (count < 0 || count > TUBEOPT_MOST_CONTACTS || bears(m) || c->closest > 0) return TUBEOPT_BAD_INPUT;
    tubeopt_status not_taken = bounded(&clearance, 1, TUBEOPT_MOST_NUMBER);
    memcpy(own, contacts, count * sizeof *own);
    for (int k = 0; k < count && !not_taken; k++) {
        const tubeopt_contact *at = contacts + k;
        double all[5] = {at->arc_length, at->normal[0], at->normal[1], at->normal[2], at->distance};
        not_taken = bounded(all, 5, TUBEOPT_MOST_NUMBER);
    }
    return not_taken ? not_taken : servo_towards(m, c, NULL, &bodies, pose, report);
}
#endif
