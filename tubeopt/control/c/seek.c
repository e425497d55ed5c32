
/* --- the closest pose to a target: descents of a second robot, while the first one rests ---------------------------- */

/* A servo only comes closer, so it rests at a local minimum of the distance. There a scout, which has memory of its own, goes
   straight to one of the STARTS, as far as the guard lets it, and from there descends to the target; and so on from the place of
   rest. The robot then goes the way of the scout that came closest: the guard has let it pass. That is repeated until no scout
   comes closer, or until the robot rests where it did before: it returns from a pose closer to the floor of the margin. Steps of a scout are as long as Newton's method allows, and take no time. */

#define ROUNDS 4       /* searches for one target at most */
#define OUTWARD 20     /* steps of a scout to its start at most: half a turn takes 11, the length of the longest tube 20 */
#define DESCENT_STEPS 300
#define STILL 6        /* steps without motion, after which it rests: the order of breakpoints is kept and released meanwhile */
#define COMPARED_EVERY 4 /* steps of a descent, */
#define PROMISING 0.15 /* which must have descended by this share of what is missing to a closer pose: others end early */
#define WHOLE_TURN 6.283185307179586
#define SPACED 0.1     /* of a joint's scale, between places of a way that are kept */
#define MUCH_CLOSER 2e-5 /* of the longest tube: what counts as closer */
#define WAY_ROOM 2e-3  /* added to the floor of the margin for scouts: the robot cuts the corners of their path */

static tubeopt_memory *scout_of(tubeopt_memory *m) { return (tubeopt_memory *)((char *)m + 2 * ROOM_OF_ONE); }

static double change_of(const tubeopt_joints *a, const tubeopt_joints *b) {
    double from[JOINTS], to[JOINTS], most = 0;
    independent(a, from);
    independent(b, to);
    for (int k = 0; k < JOINTS; k++) most = fmax(most, fabs(to[k] - from[k]) / SCALE[k]);
    return most;
}

/* How far the tip is off, over the longest tube; of a direction as well. */
static double miss_of(const tubeopt_memory *m, const tubeopt_command *c) {
    double missing[6], t[3];
    missing_to(m, c, 0, missing, t);
    return sqrt(dot(missing, missing, 6));
}

/* The scout to where the robot rests. */
static void recall(tubeopt_memory *m, Seeker *s) {
    tubeopt_memory *scout = scout_of(m);
    memcpy(scout, m, ROOM_OF_ONE);
    scout->before = NULL;
    scout->fresh = scout->moves = scout->ordered = 0;
    scout->damping = scout->damped = 0;
    scout->patience = PATIENCE;
    memset(scout->last, 0, sizeof scout->last);
    s->steps = s->still = 0;
}

/* The next scout, or none: then the robot goes the best way. */
static void send_scout(tubeopt_memory *m, Seeker *s) {
    if (s->trial == TRIALS) {
        s->stage = s->best_count ? ALONG : TOWARDS;
        s->round = s->best_count ? s->round + 1 : ROUNDS;
        s->at = s->still = 0;
        return;
    }
    double q[JOINTS], start[JOINTS];
    independent(&m->joints, q);
    for (int k = 0; k < JOINTS; k++) {
        start[k] = STARTS[s->trial * JOINTS + k];
        if (k >= N) continue;
        start[k] = q[k] + remainder(start[k] - q[k], WHOLE_TURN);
        if (start[k] < LOWER[k]) start[k] += WHOLE_TURN; /* the nearest turn is outside of the range */
        if (start[k] > UPPER[k]) start[k] -= WHOLE_TURN;
        start[k] = fmin(fmax(start[k], LOWER[k]), UPPER[k]);
    }
    dependent(start, &s->start);
    s->trial++;
    s->stage = OUT;
    recall(m, s);
}

/* One step of the scout. */
static void scout_step(tubeopt_memory *m, const tubeopt_command *c, Seeker *s) {
    tubeopt_memory *scout = scout_of(m);
    tubeopt_command far = *c;
    tubeopt_joints before = scout->joints;
    const tubeopt_joints *goal = s->stage == OUT ? &s->start : s->stage == STRAIGHT ? s->way + s->count - 1 : NULL;
    tubeopt_pose pose;
    tubeopt_report report = {0};
    Bodies none = {0};
    far.step = 1;
    far.speed = LONGEST_TUBE / 8;
    far.turn_rate = LARGEST_TURN;
    far.shift_rate = LARGEST_SHIFT * LONGEST_TUBE;
    far.turn_acceleration = far.shift_acceleration = far.push = 0;
    far.min_margin = fmin(c->min_margin + WAY_ROOM, 1);
    int failed = servo_towards(scout, &far, goal, &none, &pose, &report) != TUBEOPT_DONE;
    int there = goal && change_of(&scout->joints, goal) < CLOSE, ended = failed || ++s->steps >= OUTWARD || (report.why & TUBEOPT_HELD);
    if (s->stage == STRAIGHT) { /* the shortest way, where it leads to the same pose */
        if (!there && !ended) return;
        if (there && fabs(miss_of(scout, c) - s->best) < MUCH_CLOSER) s->way[0] = s->way[s->count - 1], s->count = 1;
        memcpy(s->best_way, s->way, sizeof s->way);
        s->best_count = s->count;
        send_scout(m, s);
    } else if (s->stage == OUT) {
        if (!there && !ended) return;
        s->way[0] = scout->joints;
        s->count = 1;
        s->steps = s->still = 0;
        s->before = INFINITY;
        s->stage = DOWN;
    } else {
        s->still = change_of(&scout->joints, &before) < CLOSE ? s->still + 1 : 0;
        if (change_of(&scout->joints, s->way + s->count - 1) > SPACED) s->way[s->count++] = scout->joints;
        double miss = miss_of(scout, c), gained = s->before - miss;
        int compared = s->steps % COMPARED_EVERY == 0;
        if (compared) s->before = miss;
        if (s->count == MOST_WAY || (compared && gained < PROMISING * (miss - s->best + MUCH_CLOSER)))
            send_scout(m, s); /* too long a way, or one that slows down far from a closer pose */
        else if (failed || s->still == STILL || s->steps == DESCENT_STEPS) {
            if (miss > s->best - MUCH_CLOSER) {
                send_scout(m, s);
                return;
            }
            s->best = miss;
            s->way[s->count++] = scout->joints;
            s->stage = STRAIGHT;
            recall(m, s);
        }
    }
}

/* One step of the robot towards a target, or of the search of a closer pose and on the way to it. */
static tubeopt_status servo_closest(tubeopt_memory *m, const tubeopt_command *c, tubeopt_pose *pose, tubeopt_report *report) {
    Seeker *s = seeker_of(m);
    Bodies none = {0};
    tubeopt_command rest = *c;
    tubeopt_joints before = m->joints;
    if (memcmp(s->position, c->position, sizeof s->position) || memcmp(s->direction, c->direction, sizeof s->direction)) {
        memcpy(s->position, c->position, sizeof s->position);
        memcpy(s->direction, c->direction, sizeof s->direction);
        s->stage = TOWARDS;
        s->round = s->still = 0;
    }
    int seeks = s->stage != TOWARDS && s->stage != ALONG;
    if (seeks) { /* it stays where it is */
        tell(m, 0, pose);
        memcpy(rest.position, pose->position, sizeof rest.position);
        memset(rest.direction, 0, sizeof rest.direction);
        rest.speed = rest.push = 0;
    }
    const tubeopt_joints *goal = s->stage == ALONG ? s->best_way + s->at : NULL;
    tubeopt_status status = servo_towards(m, &rest, goal, &none, pose, report);
    if (status) return status;
    if (seeks) report_missing(m, c, report);
    int rests = change_of(&before, &m->joints) < CLOSE, blocked = report->why & (TUBEOPT_NO_CLOSER | TUBEOPT_HELD);
    if (!seeks) s->still = rests && blocked ? s->still + 1 : 0;
    if (s->stage == ALONG) {
        if (change_of(&(m->moves ? stop_of(m) : m)->joints, goal) < CLOSE) s->at++;
        if (s->at == s->best_count || s->still == STILL) s->stage = TOWARDS, s->still = 0;
    } else if (s->stage == TOWARDS) {
        if (s->still == STILL && s->round < ROUNDS) {
            double miss = miss_of(m, c);
            if (s->round && miss > s->rested - MUCH_CLOSER && change_of(&m->joints, &s->rest) < SPACED)
                s->round = ROUNDS;
            else {
                s->best = s->rested = miss;
                s->rest = m->joints;
                s->trial = s->best_count = 0;
                send_scout(m, s);
            }
        }
    } else
        for (int k = 0; k < c->closest && k < MOST_SOLVES && s->stage != ALONG && s->stage != TOWARDS; k++) scout_step(m, c, s);
    if (s->stage != TOWARDS) report->why |= TUBEOPT_SEEKING;
    return TUBEOPT_DONE;
}
