#define APART 1e-5 /* m above the clearance, at which the arm slides: a straight step bends towards the body */
#define EDGE 1e-9  /* of the end of a tube, m, within which a contact moves along with it */

/* Whether a contact is at the edge where a tube ends before the tip. */
static int at_edge(const Answer *a, int tube, double s) {
    double end = a->tube_end[tube], tip = a->arc_length[a->pieces * STEPS];
    return end > 0 && end < tip - EDGE && fabs(s - end) <= EDGE;
}

/* Rows of the contacts that a step within the rates could bring too close. */
static void keep_clear(const tubeopt_memory *m, const Bodies *bodies, double rise, Quadratic *p, const Aim *aim) {
    const Answer *a = m->answers + m->here;
    int last = (int)a->pieces * STEPS;
    for (int i = 0; i < bodies->count; i++) {
        const tubeopt_contact *contact = bodies->contacts + i;
        double s = contact->arc_length, by[2 * N] = {0}, row[JOINTS], most = 0;
        double least = 0.5 * (bodies->clearance + APART - contact->distance);
        int k = piece_at(a->arc_length, last, s);
        double x = last ? (s - a->arc_length[k]) / (a->arc_length[k + 1] - a->arc_length[k]) : 0;
        for (int r = 0; r < 3; r++) {
            double ahead = (1 - x) * a->frame[k][3 * r + 2] + x * a->frame[k + 1][3 * r + 2];
            for (int j = 0; j < 2 * N; j++)
                by[j] += contact->normal[r] * ((1 - x) * m->along[k][r][j] + x * m->along[k + 1][r][j]);
            for (int j = 0; j < N; j++)
                if (at_edge(a, j, s)) by[N + j] += contact->normal[r] * ahead;
        }
        by_joints(by, row);
        for (int j = 0; j < JOINTS; j++) most += fabs(row[j]) * aim->rate[j];
        if (most >= -least) memcpy(new_row(p, fmin(fmin(least, RISE * most), rise)), row, sizeof row);
    }
}

/* A contact of an answer as it is at another one. */
static tubeopt_contact contact_at(const Answer *here, const Answer *next, const tubeopt_contact *contact) {
    double s = contact->arc_length, was[3], is[3];
    long long last = here->pieces * STEPS, end = next->pieces * STEPS;
    tubeopt_contact then = *contact;
    for (int j = 0; j < N; j++)
        if (at_edge(here, j, s)) then.arc_length = next->tube_end[j];
    if (s >= here->arc_length[last] - EDGE || then.arc_length > next->arc_length[end]) then.arc_length = next->arc_length[end];
    place_on(here, s, was);
    place_on(next, then.arc_length, is);
    for (int r = 0; r < 3; r++) then.distance += contact->normal[r] * (is[r] - was[r]);
    return then;
}

/* Whether the next answer brings a contact closer than it may. */
static int too_close(const tubeopt_memory *m, const Bodies *bodies) {
    for (int i = 0; i < bodies->count; i++) {
        const tubeopt_contact *contact = bodies->contacts + i;
        double distance = contact_at(m->answers + m->here, m->answers + !m->here, contact).distance;
        if (distance < bodies->clearance && distance < contact->distance) return 1;
    }
    return 0;
}

/* The contacts of a robot as they are where it comes to rest. */
static void shift_contacts(const tubeopt_memory *m, const tubeopt_memory *stop, Bodies *bodies) {
    for (int i = 0; i < bodies->count && m != stop; i++)
        bodies->contacts[i] = contact_at(m->answers + m->here, stop->answers + stop->here, bodies->contacts + i);
}
