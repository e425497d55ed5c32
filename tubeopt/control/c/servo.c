
/* --- servo ------------------------------------------------------------------------------------------------------- */

#define DAMPING 1e-3 /* of a joint's scale against the tip's way as a share of the robot's length */
#define HALVINGS 4   /* of a step that the guard does not let pass */
#define CLOSE 1e-9
#define ROOM 0.01  /* of the margin above its floor, at which the tip slides: a step along the floor bends away from it */
#define RISE 0.3   /* share of what joints could do for margin or clearance that a step must do at most */

typedef struct {
    double task[6][JOINTS], missing[6]; /* by independent joints over their scale */
    double margin[JOINTS], rate[JOINTS], low[JOINTS], high[JOINTS];
    int rows, why;
} Aim;

/* What the arm is to keep clear of. */
typedef struct {
    int count;
    double clearance;
#if TUBEOPT_BODIES
    const tubeopt_contact *contacts;
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

/* What is missing to the command, at most what its speed allows, and how the tip answers to the joints. */
static void aim_at(const tubeopt_memory *m, const tubeopt_command *c, Aim *aim, tubeopt_report *report) {
    tubeopt_pose here;
    double gap[3], distance = 0, length = 0, turned = 0;
    tell(m, 0, &here);
    for (int r = 0; r < 3; r++) gap[r] = c->position[r] - here.position[r];
    distance = sqrt(dot(gap, gap, 3));
    double share = distance > c->speed * c->step ? c->speed * c->step / distance : 1;
    for (int r = 0; r < 3; r++) {
        by_joints(m->slopes.position[r], aim->task[r]);
        for (int k = 0; k < JOINTS; k++) aim->task[r][k] /= LONGEST_TUBE;
        aim->missing[r] = share * gap[r] / LONGEST_TUBE;
    }
    aim->rows = 3;
    report->distance = distance;
    report->angle = 0;
    length = sqrt(dot(c->direction, c->direction, 3));
    by_joints(m->slopes.margin, aim->margin);
    if (!(length > 0)) return;
    for (int r = 0; r < 3; r++) { /* the change of the direction t is turn x t */
        int one = (r + 1) % 3, two = (r + 2) % 3;
        double t[3] = {here.frame[2], here.frame[5], here.frame[8]}, first[JOINTS], second[JOINTS];
        by_joints(m->slopes.turn[one], first);
        by_joints(m->slopes.turn[two], second);
        for (int k = 0; k < JOINTS; k++) aim->task[3 + r][k] = first[k] * t[two] - second[k] * t[one];
        aim->missing[3 + r] = c->direction[r] / length - t[r];
        turned += aim->missing[3 + r] * aim->missing[3 + r];
    }
    report->angle = 2 * asin(fmin(1, sqrt(turned) / 2));
    double most = c->speed * c->step / (LONGEST_TUBE / 10); /* as fast as the tip would turn about a tenth of the robot */
    for (int r = 3; r < 6 && turned > most * most; r++) aim->missing[r] *= most / sqrt(turned);
    aim->rows = 6;
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
#endif

/* Rows of a step over the joints' scale: rates and ranges, order, floor of the margin, which it need not raise by more
   than `rise`; where that is 0, to stay keeps them all. */
static void hedge(const tubeopt_memory *m, const tubeopt_command *c, const Bodies *bodies, const double *q, double rise,
                  Quadratic *p, Aim *aim) {
    p->count = 0;
    for (int k = 0; k < JOINTS; k++) {
        double rate = fmin((k < N ? c->turn_rate : c->shift_rate) * c->step, k < N ? LARGEST_TURN : LARGEST_SHIFT * LONGEST_TUBE);
        aim->rate[k] = rate / SCALE[k];
        aim->low[k] = fmin(0, fmax(-rate, LOWER[k] - q[k])) / SCALE[k];
        aim->high[k] = fmax(0, fmin(rate, UPPER[k] - q[k])) / SCALE[k];
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
    double raised = fmin(fmin(0.5 * (c->min_margin + ROOM - margin_told(m, 0)), RISE * most), rise);
    memcpy(new_row(p, raised), aim->margin, sizeof aim->margin);
    keep_clear(m, bodies, rise, p, aim);
}

/* The step (n) over the joints' scale that brings the tip closest, in least squares with a little damping, and within
   what that leaves free towards a larger margin. 0 where there is none. */
static int step_towards(tubeopt_memory *m, const tubeopt_command *c, const Bodies *bodies, const double *q, double rise,
                        Aim *aim, double *step) {
    double matrix[(6 + JOINTS) * JOINTS], right[6 + JOINTS];
    Quadratic p = {m->rows, m->bounds, m->multipliers, JOINTS, 0, {0}, 0};
    hedge(m, c, bodies, q, rise, &p, aim);
    double steep = sqrt(dot(aim->margin, aim->margin, JOINTS)), push = steep > 0 ? c->push * c->turn_rate * c->step / steep : 0;
    memset(matrix, 0, sizeof matrix);
    memcpy(matrix, aim->task, aim->rows * sizeof aim->task[0]);
    memcpy(right, aim->missing, aim->rows * sizeof(double));
    for (int k = 0, r = aim->rows; k < JOINTS; k++, r++) {
        matrix[r * JOINTS + k] = DAMPING;
        right[r] = DAMPING * push * aim->margin[k];
    }
    if (!least_squares(&p, aim->rows + JOINTS, matrix, right, step)) return 0;
    aim->why = 0;
    for (int k = 0; k < p.actives; k++) {
        int r = p.active[k], joint = r / 2;
        if (r >= 2 * JOINTS)
            aim->why |= r < 2 * JOINTS + ORDERS ? TUBEOPT_AT_ORDER : r == 2 * JOINTS + ORDERS ? TUBEOPT_AT_MARGIN : TUBEOPT_AT_BODY;
        else {
            double end = r % 2 ? UPPER[joint] - q[joint] : q[joint] - LOWER[joint], used = fabs(step[joint]) * SCALE[joint];
            aim->why |= end <= used + CLOSE ? TUBEOPT_AT_RANGE : TUBEOPT_AT_RATE;
        }
    }
    return 1;
}

static tubeopt_status not_commanded(const tubeopt_command *c) {
    double all[12] = {c->step, c->speed, c->turn_rate, c->shift_rate, c->min_margin, c->push};
    memcpy(all + 6, c->position, sizeof c->position);
    memcpy(all + 9, c->direction, sizeof c->direction);
    int possible = c->step > 0 && c->speed >= 0 && c->turn_rate >= 0 && c->shift_rate >= 0 && c->push >= 0;
    if (!possible) return TUBEOPT_BAD_INPUT;
    tubeopt_status found = bounded(all, 12, TUBEOPT_MOST_NUMBER);
    int away = sqrt(dot(c->position, c->position, 3)) > TUBEOPT_MOST_AWAY * LONGEST_TUBE;
    return found == TUBEOPT_DONE && away ? TUBEOPT_TOO_LARGE : found;
}

static tubeopt_status servo_step(tubeopt_memory *m, const tubeopt_command *c, const Bodies *bodies, tubeopt_pose *pose,
                                 tubeopt_report *report) {
    Aim aim;
    tubeopt_joints next;
    double q[JOINTS], step[JOINTS], there[JOINTS], floor;
    if (!m->started) return TUBEOPT_NOT_STARTED;
    tubeopt_status not_taken = not_commanded(c);
    if (not_taken) return not_taken;
    independent(&m->joints, q); /* which has one translation for all tubes without play between them */
    dependent(q, &next);
    for (int i = 0; i < N; i++)
        if (fabs(next.translations[i] - m->joints.translations[i]) > CLOSE) return TUBEOPT_BAD_INPUT;
    report->solves = 0;
    report->why = TUBEOPT_HELD;
    if (look_ahead(m, 0)) return TUBEOPT_DECLINED;
    const Answer *here = m->answers + m->here;
    m->origin = m->joints;
    keep_loaded(m);
    aim_at(m, c, &aim, report);
    floor = fmin(c->min_margin, margin_told(m, 0)); /* what is below it does not get worse */
    if (step_towards(m, c, bodies, q, 1, &aim, step) || step_towards(m, c, bodies, q, 0, &aim, step)) {
        double share = 1;
        for (int k = 0; k < JOINTS; k++) step[k] = fmin(fmax(step[k], aim.low[k]), aim.high[k]); /* of rounding */
        for (int half = 0; half <= HALVINGS; half++, share /= 2) {
            for (int k = 0; k < JOINTS; k++)
                there[k] = fmin(fmax(q[k] + share * SCALE[k] * step[k], fmin(q[k], LOWER[k])), fmax(q[k], UPPER[k]));
            dependent(there, &next);
            report->solves++;
            if (step_to(m, &next) || bear_to(m, &next, 1) || margin_told(m, 1) < floor || too_close(m, bodies)) continue;
            accept(m, &next);
            accept_loaded(m);
            report->why = aim.why | (half ? TUBEOPT_SHORTENED : 0);
            break;
        }
    }
    m->before = here;
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}

tubeopt_status tubeopt_servo(tubeopt_memory *m, const tubeopt_command *c, tubeopt_pose *pose, tubeopt_report *report) {
    const Bodies none = {0};
    return servo_step(m, c, &none, pose, report);
}

#if TUBEOPT_BODIES
tubeopt_status tubeopt_servo_among(tubeopt_memory *m, const tubeopt_command *c, int count,
                                   const tubeopt_contact *contacts, double clearance, tubeopt_pose *pose,
                                   tubeopt_report *report) {
    const Bodies bodies = {count, clearance, contacts};
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (count < 0 || count > TUBEOPT_MOST_CONTACTS || bears(m)) return TUBEOPT_BAD_INPUT;
    tubeopt_status not_taken = bounded(&clearance, 1, TUBEOPT_MOST_NUMBER);
    for (int k = 0; k < count && !not_taken; k++) {
        const tubeopt_contact *at = contacts + k;
        double all[5] = {at->arc_length, at->normal[0], at->normal[1], at->normal[2], at->distance};
        not_taken = bounded(all, 5, TUBEOPT_MOST_NUMBER);
    }
    return not_taken ? not_taken : servo_step(m, c, &bodies, pose, report);
}
#endif
