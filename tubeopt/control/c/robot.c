
/* --- the robot in the hands of a program ------------------------------------------------------------------------- */

#define MOST_PARTS 64
#define PATIENCE 8             /* damped servo steps far from rest, twice as many each time, before one without damping */
#define MOST_SOLVES 256        /* of one call */
#define SHORTEST_PART (1 / 300.) /* of a step of ordinary length */
#define TURN_PRECISION 0.02    /* of a snap distance: five checks */

#if TUBEOPT_LOADS
size_t tubeopt_bearing_size(void);
int tubeopt_bearing_grow(void *room, const tubeopt_load *load, const tubeopt_joints *joints, int pieces, const double *s,
                         const double (*rotation)[N], double margin);
int tubeopt_bearing_step(void *room, const tubeopt_load *load, const tubeopt_joints *joints);
void tubeopt_bearing_accept(void *room);
const tubeopt_pose *tubeopt_bearing_pose(const void *room, int next);
void tubeopt_bearing_compliance(const void *room, double *out);
int tubeopt_bearing_arm(const void *room, const double **s, const double (**position)[3], const double (**frame)[9]);
void tubeopt_bearing_keep(void *room);
void tubeopt_bearing_return(void *room);
int tubeopt_bearing_couple(void *room);
int tubeopt_bearing_turns(void *room, double r);
double tubeopt_bearing_turn(void *room, double most, double precision);
#endif

#if !SLOPES
typedef tubeopt_slopes Slopes;
#endif

/* Joint values at which turns of all tubes, each by up to `turn` (rad), are proved to cause no snap; 0: nothing is proved. Without
   a load, turning all tubes alike changes nothing. */
typedef struct {
    tubeopt_joints centre;
    double turn;
    int loaded;
} Ball;

#define MOST_WAY 64 /* places of a way to a closer pose */

/* What a search of the closest pose knows: see servo_closest. */
typedef struct {
    enum { TOWARDS, OUT, DOWN, STRAIGHT, ALONG } stage; /* robot towards the target; scout; robot along the best way */
    double position[3], direction[3], best, before;     /* target, smallest miss, and that of a descent some steps before */
    double rested;                                      /* miss at the rest from which scouts went last */
    int round, trial, steps, still, count, best_count, at;
    tubeopt_joints start, rest, way[MOST_WAY], best_way[MOST_WAY];
} Seeker;

struct tubeopt_memory {
    Workspace work;
    Answer answers[2], first;                           /* the last equilibrium, room for the next; start of a motion */
    int here, started, fresh;                           /* fresh: the workspace has the last equilibrium */
    const Answer *before;                               /* to which tubeopt_undo leads, NULL where nothing does */
    tubeopt_joints joints, origin;                      /* of the last one, and of that before */
    Slopes slopes;
#if TUBEOPT_BODIES
    Along along[MOST_SHAPE];
#endif
    double rows[MOST_ROWS * JOINTS], bounds[MOST_ROWS], multipliers[MOST_ROWS]; /* of a servo step */
    double low[JOINTS], high[JOINTS];                   /* ends of the next step of a servo within rates */
    double speed[JOINTS], slower[JOINTS];               /* of a robot whose accelerations are limited; before the last step */
    int moves, was_moving;                              /* its stop point, after this memory, is in use; for tubeopt_undo */
    Ball ball;                                          /* that a servo with a least snap distance proved last */
    double wall;                                        /* margin that such a servo keeps, since less was closer to a snap */
    int ordered, progress;                              /* whether servo steps keep the order of breakpoints, and one was taken */
    double damping, ease, last[JOINTS], stiff[JOINTS], goal[3], damped, patience; /* squared, of steps that did not bring the tip closer; part of the push; last step */
#if TUBEOPT_LOADS
    int bears;
    tubeopt_load load, next_load;                       /* current load, and load at the end of the motion */
#endif
};

#if TUBEOPT_LOADS
#define OWN_ROOM ((sizeof(tubeopt_memory) + 63) / 64 * 64)

static void *room_of(const tubeopt_memory *m) { return (char *)m + OWN_ROOM; }

#define ROOM_OF_ONE (OWN_ROOM + (tubeopt_bearing_size() + 63) / 64 * 64)

static int bears(const tubeopt_memory *m) { return m->bears; }

/* One step of the loaded arm at the fraction t of the path to the next load, without accepting it; after that of the unloaded one. */
static int bear_to(tubeopt_memory *m, const tubeopt_joints *joints, double t) {
    tubeopt_load at;
    for (int r = 0; r < 3; r++) {
        at.force[r] = (1 - t) * m->load.force[r] + t * m->next_load.force[r];
        at.gravity[r] = (1 - t) * m->load.gravity[r] + t * m->next_load.gravity[r];
    }
    return m->bears && tubeopt_bearing_step(room_of(m), &at, joints);
}

static void accept_loaded(tubeopt_memory *m) {
    if (m->bears) tubeopt_bearing_accept(room_of(m));
}

static void keep_loaded(tubeopt_memory *m) {
    if (m->bears) tubeopt_bearing_keep(room_of(m));
}

static void return_loaded(tubeopt_memory *m) {
    if (m->bears) tubeopt_bearing_return(room_of(m));
}

static int couple_loaded(tubeopt_memory *m) { return !m->bears || tubeopt_bearing_couple(room_of(m)); }

static int proves_loaded(tubeopt_memory *m, double r) { return !m->bears || tubeopt_bearing_turns(room_of(m), r); }
#else
#define ROOM_OF_ONE ((sizeof(tubeopt_memory) + 63) / 64 * 64)
#define bears(memory) 0
#define bear_to(memory, joints, t) 0
#define keep_loaded(memory)
#define return_loaded(memory)
#define couple_loaded(memory) 1
#define proves_loaded(memory, r) 1
#define accept_loaded(memory)
#endif

#define ROOMS (TRIALS ? 3 : 2) /* the robot, where it comes to rest, and a scout */

size_t tubeopt_memory_size(void) { return ROOMS * ROOM_OF_ONE + sizeof(Seeker); }

static tubeopt_memory *stop_of(tubeopt_memory *m) { return (tubeopt_memory *)((char *)m + ROOM_OF_ONE); }

static Seeker *seeker_of(tubeopt_memory *m) { return (Seeker *)((char *)m + ROOMS * ROOM_OF_ONE); }

tubeopt_memory *tubeopt_start(void *memory) {
    memset(memory, 0, tubeopt_memory_size());
    return memory;
}

/* Whether numbers are finite and none is too large: TUBEOPT_DONE, or what they are refused with. */
static tubeopt_status bounded(const double *numbers, int count, double most) {
    tubeopt_status found = TUBEOPT_DONE;
    for (int k = 0; k < count; k++) {
        if (!isfinite(numbers[k])) return TUBEOPT_BAD_INPUT;
        if (fabs(numbers[k]) > most) found = TUBEOPT_TOO_LARGE;
    }
    return found;
}

static tubeopt_status refused(const tubeopt_joints *joints) {
    tubeopt_status turned = bounded(joints->rotations, N, TUBEOPT_MOST_TURN);
    tubeopt_status moved = bounded(joints->translations, N, TUBEOPT_MOST_NUMBER);
    if (turned == TUBEOPT_BAD_INPUT || moved == TUBEOPT_BAD_INPUT) return TUBEOPT_BAD_INPUT;
    for (int i = 0; i < N; i++) {
        if (joints->translations[i] < -TUBEOPT_MOST_BACK * ROBOT.whole[i]) moved = TUBEOPT_TOO_LARGE;
        if (joints->translations[i] - ROBOT.straight[i] > ROUND_OFF_LENGTH) return TUBEOPT_BAD_INPUT;
        for (int j = 0; j < i; j++)
            if (CARRIAGES[j] == CARRIAGES[i] && fabs(joints->translations[j] - joints->translations[i]) > ROUND_OFF_LENGTH)
                return TUBEOPT_BAD_INPUT;
    }
    return turned ? turned : moved;
}

/* Write the last equilibrium, or the `next` one, which is not accepted, without its joints. */
static void tell(const tubeopt_memory *m, int next, tubeopt_pose *pose) {
    const Answer *a = m->answers + (next ? !m->here : m->here);
    long long tip = a->pieces * STEPS;
#if TUBEOPT_LOADS
    if (m->bears) {
        *pose = *tubeopt_bearing_pose(room_of(m), next);
        return;
    }
#endif
    pose->joints = m->joints;
    memcpy(pose->position, a->position[tip], sizeof pose->position);
    memcpy(pose->frame, a->frame[tip], sizeof pose->frame);
    memcpy(pose->tip_rotations, a->tip_rotations, sizeof pose->tip_rotations);
    pose->margin = a->margin;
    pose->energy = a->energy;
    pose->error = a->tip_error;
    pose->residual = a->residual;
}

/* The margin of the same, with the load and without. */
static double stated_margin(const tubeopt_memory *m, int next) {
    double own = m->answers[next ? !m->here : m->here].margin;
    tubeopt_pose pose;
    tell(m, next, &pose);
    return fmin(own, pose.margin);
}

/* Turn of all tubes that a ball allows at joint values, rad; -1 outside of it. */
static double turn_left(const Ball *ball, const tubeopt_joints *at) {
    double least = INFINITY, most = -INFINITY;
    for (int i = 0; i < N; i++) {
        double by = at->rotations[i] - ball->centre.rotations[i];
        if (fabs(at->translations[i] - ball->centre.translations[i]) > ROUND_OFF_LENGTH) return -1;
        least = fmin(least, by), most = fmax(most, by);
    }
    return fmax(-1, ball->turn - (ball->loaded ? fmax(most, -least) : (most - least) / 2));
}

#if SLOPES
/* Whether couplings, from which a snap distance follows, are found in the workspaces: of what was solved last. */
static int couple(tubeopt_memory *m) {
    Workspace *w = &m->work;
    return find_couplings(&w->fine, &w->state, &w->trial, &w->chain, &w->couplings) && couple_loaded(m);
}

/* Whether turns of all tubes by up to r are then proved to cause no snap, with the load and without. */
static int proves(tubeopt_memory *m, double r) { return proves_turn(&m->work.couplings, r) && proves_loaded(m, r); }

/* The same of turns of any size, where no turn can snap; under a load that is not known. */
static int never_snaps(const tubeopt_memory *m) {
    const Couplings *now = &m->work.couplings;
    return !bears(m) && (!now->count || convex_in(now, NULL));
}
#endif

/* The other answer, which was solved just now, becomes the last one. */
static void accept(tubeopt_memory *m, const tubeopt_joints *joints) {
    m->here = !m->here;
    m->fresh = m->started = 1;
    m->joints = *joints;
}

/* One step along the branch, without accepting it: 0, or 1 where it is not small or Newton's method is not at ease. */
static int step_to(tubeopt_memory *m, const tubeopt_joints *joints) {
    m->fresh = 0;
    m->before = NULL; /* the next answer takes its room */
    return small_step(&ROBOT, m->answers + m->here, m->joints.rotations, m->joints.translations, joints->rotations,
                      joints->translations, &m->work, m->answers + !m->here);
}

/* The workspace is to have the last equilibrium, solved anew where it has not; 1 where that fails. */
static int refresh(tubeopt_memory *m) {
    tubeopt_joints same = m->joints;
    if (m->fresh) return 0;
    if (step_to(m, &same)) return 1;
    accept(m, &same);
    return 0;
}

/* The place at fraction t of a straight motion, its end exactly. */
static tubeopt_joints between(const tubeopt_joints *from, const tubeopt_joints *to, double t) {
    tubeopt_joints at;
    for (int i = 0; i < N; i++) {
        at.rotations[i] = to->rotations[i] - (1 - t) * (to->rotations[i] - from->rotations[i]);
        at.translations[i] = to->translations[i] - (1 - t) * (to->translations[i] - from->translations[i]);
    }
    return at;
}

/* From the last equilibrium along a straight path to other joint values and the next load, in parts of at most `longest` that
   keep the branch. 1 where that ends, and all stays as it was. */
static int keep_branch(tubeopt_memory *m, const tubeopt_joints *to, double longest) {
    tubeopt_joints from = m->joints;
    double step = longest, done = 0;
    m->first = m->answers[m->here];
    m->origin = from;
    keep_loaded(m);
    for (int solves = 0; done < 1; solves++) {
        double t = done + step >= 1 - 1e-12 ? 1 : done + step;
        tubeopt_joints at = between(&from, to, t);
        if (solves == MOST_SOLVES || step < longest * SHORTEST_PART) { /* the branch has ended, or nearly so */
            if (done > 0) {
                m->answers[m->here] = m->first;
                m->joints = from;
                m->fresh = 0;
                return_loaded(m);
            }
            return 1;
        }
        if (step_to(m, &at) || bear_to(m, &at, t)) {
            step /= 4;
            continue;
        }
        accept(m, &at);
        accept_loaded(m);
        done = t;
        step = fmin(2 * step, longest);
    }
    m->before = &m->first;
    return 0;
}

#if TUBEOPT_LOADS
#include "bearing.c"
#endif

tubeopt_status tubeopt_solve(tubeopt_memory *m, const tubeopt_joints *joints, tubeopt_pose *pose) {
    tubeopt_status not_taken = refused(joints);
    if (not_taken) return not_taken;
    m->fresh = m->moves = 0;
    m->before = NULL;
    m->damping = m->ball.turn = m->wall = 0; /* a servo begins anew */
    seeker_of(m)->position[0] = INFINITY;
    m->ease = 1;
    m->patience = PATIENCE;
    memset(m->last, 0, sizeof m->last);
    if (solve(&ROBOT, joints->rotations, joints->translations, NULL, &m->work, m->answers + !m->here))
        return TUBEOPT_DECLINED;
    accept(m, joints);
#if TUBEOPT_LOADS
    if (m->bears) { /* the branch starts anew, without load */
        m->bears = 0;
        return tubeopt_bear(m, &m->load, pose);
    }
#endif
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}

tubeopt_status tubeopt_follow(tubeopt_memory *m, const tubeopt_joints *joints, tubeopt_pose *pose) {
    if (!m->started) return TUBEOPT_NOT_STARTED;
    tubeopt_status not_taken = refused(joints);
    if (not_taken) return not_taken;
    const Answer *last = m->answers + m->here;
    double length = fmax(last->arc_length[last->pieces * STEPS], LONGEST_TUBE / 10);
    double parts = parts_of(m->joints.rotations, m->joints.translations, joints->rotations, joints->translations, length);
    if (parts > MOST_PARTS) return TUBEOPT_TOO_FAR;
    if (keep_branch(m, joints, 1 / parts)) return TUBEOPT_SNAP;
    m->moves = m->ball.turn = 0; /* another branch may lead back into the ball */
    seeker_of(m)->position[0] = INFINITY;
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}

tubeopt_status tubeopt_undo(tubeopt_memory *m, tubeopt_pose *pose) {
    if (!m->before) return TUBEOPT_NOT_STARTED;
    if (m->before == &m->first)
        m->answers[m->here] = m->first;
    else
        m->here = (int)(m->before - m->answers);
    m->joints = m->origin;
    m->fresh = 0;
    m->before = NULL;
    return_loaded(m);
    if (m->moves && m->was_moving) {
        tubeopt_undo(stop_of(m), pose);
        memcpy(m->speed, m->slower, sizeof m->speed);
    }
    tell(m, 0, pose);
    return TUBEOPT_DONE;
}

static void independent(const tubeopt_joints *joints, double *q) {
    for (int c = 0; c < JOINTS; c++)
        q[c] = c < N ? joints->rotations[c] : joints->translations[FIRST[c]] - OFFSET[N + FIRST[c]];
}

/* Which joints are translations that can shrink but not grow, for their range or for the order of the tubes. Where breakpoints coincide, as where a tube is stopped by the end of another one, derivatives differ to both sides. */
static void only_backward(const tubeopt_memory *m, int *blocked) {
    double q[JOINTS], close = 1e-9 * LONGEST_TUBE;
    independent(&m->joints, q);
    for (int c = 0; c < JOINTS; c++) {
        int stopped = UPPER[c] - q[c] <= close, free = c >= N && q[c] - LOWER[c] > close;
        for (int r = 0; r < ORDERS; r++) {
            const double *row = ORDER + r * JOINTS;
            if (dot(row, q, JOINTS) - LEAST[r] > close) continue;
            stopped |= row[c] < 0;
            free &= !(row[c] > 0);
        }
        blocked[c] = stopped && free;
    }
}

#if TUBEOPT_LOADS || !SLOPES
#include "differences.c"
#endif

/* Derivatives of the last equilibrium, without load, into m->slopes: by translations that grow, or for a servo step, which
   need not be `exact`, by every translation towards a side to which it can move. 1 where that fails. */
#if SLOPES
static int look_ahead(tubeopt_memory *m, int exact) {
    int blocked[JOINTS];
    Asked asked = {.compliance = exact};
    if (refresh(m)) return 1;
    only_backward(m, blocked);
    for (int i = 0; i < N; i++) {
        asked.carriage[i] = CARRIAGES[i];
        asked.side[i] = !exact && blocked[N + CARRIAGES[i]] ? -1 : 1;
    }
    return !differentiate(&asked, &m->work, m->answers + m->here, &m->slopes, exact ? NULL : m->along);
}
#else
static int look_ahead(tubeopt_memory *m, int exact) { return differences(m, exact, &m->slopes); }
#endif

tubeopt_status tubeopt_slopes_at(tubeopt_memory *m, tubeopt_slopes *slopes) {
    if (!m->started) return TUBEOPT_NOT_STARTED;
#if TUBEOPT_LOADS
    if (m->bears) {
        tubeopt_bearing_compliance(room_of(m), slopes->compliance[0]);
        return differences(m, 1, slopes) ? TUBEOPT_DECLINED : TUBEOPT_DONE;
    }
#endif
    if (look_ahead(m, 1)) return TUBEOPT_DECLINED;
    memcpy(slopes, &m->slopes, sizeof *slopes); /* the kernel's begin with the same numbers */
    return TUBEOPT_DONE;
}

double tubeopt_snap_distance(tubeopt_memory *m, double most) {
#if SLOPES
    if (!m->started || refresh(m)) return -1;
#if TUBEOPT_LOADS
    tubeopt_joints same = m->joints;
    if (m->bears && bear_to(m, &same, 0)) return -1;
#endif
    if (!couple(m)) return -1;
    double turn = largest_turn(&m->work.couplings, most, TURN_PRECISION); /* without a load: it may be released */
#if TUBEOPT_LOADS
    if (m->bears) turn = tubeopt_bearing_turn(room_of(m), fmin(most, turn), TURN_PRECISION);
#endif
    return turn;
#else
    (void)m, (void)most;
    return -1;
#endif
}

double tubeopt_snap_time(tubeopt_memory *m, double turn_rate, double shift_rate, double most) {
#if SLOPES
    if (m->started && !bears(m) && most > 0 && turn_rate >= 0 && shift_rate >= 0) {
        Workspace *w = &m->work;
        Guess guess = guess_of(m->answers + m->here, NULL, m->joints.translations);
        int lacked = 0;
        double time = largest_motion(&ROBOT, m->joints.rotations, m->joints.translations, turn_rate, shift_rate, most, TURN_PRECISION, &guess,
                                     &w->slides, &w->trial, &w->chain, &w->couplings, &lacked);
        return lacked && !time ? -1 : time;
    }
#endif
    (void)m, (void)turn_rate, (void)shift_rate, (void)most;
    return -1;
}

tubeopt_status tubeopt_shape(const tubeopt_memory *m, int count, double *arc_length, double (*position)[3]) {
    if (!m->started) return TUBEOPT_NOT_STARTED;
    if (count < 2) return TUBEOPT_BAD_INPUT;
    const Answer *a = m->answers + m->here;
    const double *along = a->arc_length, (*place)[3] = a->position, (*frame)[9] = a->frame;
    int last = (int)a->pieces * STEPS;
#if TUBEOPT_LOADS
    if (m->bears) last = tubeopt_bearing_arm(room_of(m), &along, &place, &frame);
#endif
    if (!last) { /* an arm of length zero */
        memset(arc_length, 0, count * sizeof(double));
        memset(position, 0, count * sizeof position[0]);
        return TUBEOPT_DONE;
    }
    for (int c = 0; c < count; c++) {
        arc_length[c] = along[last] * c / (count - 1);
        on_curve(along, place, frame, piece_at(along, last, arc_length[c]), arc_length[c], position[c]);
    }
    return TUBEOPT_DONE;
}
