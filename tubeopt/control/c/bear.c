
/* --- an arm under a dead force at its tip and its weight ---------------------------------------------------------- */

#define RULES 3

/* Mesh and cross-sections at joint values: what equilibrium/load_problem.py and block/transcription/mesh.py do. */
typedef struct {
    int pieces, tip_tube;
    double whole, start[MOST_PIECES], length[MOST_PIECES];
    double stiffness[MOST_PIECES][N], moment[MOST_PIECES][N], beyond[MOST_PIECES], mass[MOST_PIECES];
    double bent[MOST_PIECES][N], felt[MOST_PIECES][N], held[N], end[N];
} Bed;

/* What a problem points to. */
typedef struct {
    double stiffness[MOST_POINTS][N], moment[MOST_POINTS][N], phase[MOST_POINTS][N], rate[MOST_POINTS][N];
    double force[MOST_POINTS][3];
} Along;

typedef struct {
    Bed beds[2];
    Along along[RULES];
    double ends_stiffness[(STEPS + 1) * MOST_PIECES][N], ends_moment[(STEPS + 1) * MOST_PIECES][N];
    double ends_rate[(STEPS + 1) * MOST_PIECES][N], none[(STEPS + 1) * MOST_PIECES][N], base_force[3];
    Rules rules;
    Workspace work;
    Answer answers[2];
    int here;
    double theta[MOST_POINTS][N], curvature[MOST_POINTS][2];
    tubeopt_joints joints; /* of the last equilibrium */
    Bed kept_bed;
    Answer kept;
    tubeopt_joints kept_joints;
} Bearing;

size_t tubeopt_bearing_size(void) { return sizeof(Bearing); }

/* A section of the arm as a row of pieces, short enough for coupling, bend and force; 0 where there is no room. */
static int lay_section(Bed *bed, const Layout *l, double from, double to, double force, double whole,
                       const double *transition) {
    double kb[N], m[N], total = 0, natural = 0, pull = 0, mass = 0, middle = (from + to) / 2;
    int present[N], curved[N];
    for (int i = 0; i < N; i++) {
        present[i] = middle < l->end[i];
        curved[i] = present[i] && middle > transition[i] && ROBOT.curvature[i] != 0;
        kb[i] = present[i] ? ROBOT.kb[i] : 0;
        m[i] = curved[i] ? kb[i] * ROBOT.curvature[i] : 0;
        total += kb[i];
        mass += present[i] ? MASS[i] : 0;
        if (!curved[i]) continue;
        natural = fmax(natural, fabs(ROBOT.curvature[i]));
        pull = fmax(pull, fabs(m[i]) / ROBOT.kt[i]);
    }
    double fast = sqrt(force / total), bend = fmin(2 * fast, force * whole / total);
    double waves = fmax(fmax(fastest_growth(ROBOT.kt, m, kb), fast), sqrt(pull * bend)) / LOADED_WAVES;
    double wanted = fmax(1, ceil(fmax(waves, (natural + bend) / BEND_PER_PIECE) * (to - from) - 1e-9));
    if (bed->pieces + wanted > MOST_PIECES) return 0;
    for (int j = 0; j < (int)wanted; j++) {
        int p = bed->pieces++;
        bed->length[p] = (to - from) / wanted;
        bed->start[p] = from + j * bed->length[p];
        bed->mass[p] = mass;
        for (int i = 0; i < N; i++) {
            bed->stiffness[p][i] = kb[i];
            bed->moment[p][i] = m[i];
            bed->bent[p][i] = curved[i];
        }
    }
    return 1;
}

static int lay_bed(Bed *bed, const double *shift, const tubeopt_load *load) {
    Layout l;
    double transition[N], cuts[MOST_CUTS], weight = 0, force = sqrt(dot(load->force, load->force, 3));
    int count = cuts_of(&ROBOT, shift, &l, transition, cuts);
    if (count < 2) return 0;
    bed->pieces = bed->tip_tube = 0;
    bed->whole = cuts[count - 1];
    for (int i = 0; i < N; i++) {
        bed->held[i] = l.transmission[i] / ROBOT.kt[i];
        bed->end[i] = fmax(l.end[i], 0);
        weight += MASS[i] * bed->end[i];
        if (l.end[i] > l.end[bed->tip_tube]) bed->tip_tube = i;
    }
    force += weight * sqrt(dot(load->gravity, load->gravity, 3));
    for (int k = 0; k + 1 < count; k++)
        if (!lay_section(bed, &l, cuts[k], cuts[k + 1], force, bed->whole, transition)) return 0;
    double beyond = 0;
    for (int p = bed->pieces - 1; p >= 0; p--) {
        bed->beyond[p] = beyond;
        beyond += bed->mass[p] * bed->length[p];
        for (int i = 0; i < N; i++) /* twist matters up to where a tube bends for the last time, and to the tip */
            bed->felt[p][i] = i == bed->tip_tube || bed->bent[p][i] > 0 || (p + 1 < bed->pieces && bed->felt[p + 1][i] > 0);
    }
    return 1;
}

/* A problem on a rule. */
static void lay_rule(Bearing *b, const Bed *bed, const tubeopt_load *load, int which, Problem *out) {
    const Rule *rule = RULE + which;
    Along *along = b->along + which;
    int k = (int)rule->degree;
    for (int x = 0; x < bed->pieces * k; x++) {
        int p = x / k;
        double mass = bed->beyond[p] + bed->mass[p] * bed->length[p] * (1 - rule->nodes[x % k]);
        for (int i = 0; i < N; i++) {
            along->stiffness[x][i] = bed->stiffness[p][i];
            along->moment[x][i] = bed->moment[p][i];
            along->phase[x][i] = 0;
            along->rate[x][i] = 1 / ROBOT.kt[i];
        }
        for (int r = 0; r < 3; r++) along->force[x][r] = load->force[r] + mass * load->gravity[r];
    }
    Problem problem = {bed->pieces, rule->degree, bed->tip_tube, bed->whole, rule->weights, rule->matrix, bed->start,
                       bed->length, along->stiffness[0], along->moment[0], along->phase[0], along->rate[0],
                       bed->bent[0], bed->felt[0], bed->held, along->force[0], b->base_force, rule->basis, rule->once,
                       rule->twice, b->ends_stiffness[0], b->ends_moment[0], b->none[0], b->ends_rate[0], b->none[0],
                       b->none[0]};
    *out = problem;
}

/* All three problems of a bed. */
static void lay_rules(Bearing *b, const Bed *bed, const tubeopt_load *load) {
    for (int x = 0; x < (STEPS + 1) * bed->pieces; x++)
        for (int i = 0; i < N; i++) {
            b->ends_stiffness[x][i] = bed->stiffness[x / (STEPS + 1)][i];
            b->ends_moment[x][i] = bed->moment[x / (STEPS + 1)][i];
            b->ends_rate[x][i] = 1 / ROBOT.kt[i];
            b->none[x][i] = 0;
        }
    double mass = bed->beyond[0] + bed->mass[0] * bed->length[0];
    for (int r = 0; r < 3; r++) b->base_force[r] = load->force[r] + mass * load->gravity[r];
    lay_rule(b, bed, load, 0, &b->rules.problem);
    lay_rule(b, bed, load, 1, &b->rules.rough);
    lay_rule(b, bed, load, 2, &b->rules.check);
    b->rules.to_rough = TO_ROUGH;
    b->rules.to_check = TO_CHECK;
    b->rules.from_rough = FROM_ROUGH;
}

/* Rotations at the points of a bed from `count` samples along another arm: rotation and torsion k * step apart. */
static void sample_arm(const Bed *bed, int count, const double *s, const double *rotation, const double *torsion,
                       int by_tube, double theta[][N]) {
    int k = 0;
    for (int x = 0; x < bed->pieces * DEGREE; x++) {
        int p = x / DEGREE;
        double at = bed->start[p] + bed->length[p] * RULE[0].nodes[x % DEGREE];
        while (k + 2 < count && s[k + 1] <= at) k++;
        double h = s[k + 1] - s[k], t = fmin(fmax((at - s[k]) / h, 0), 1), u = 1 - t;
        for (int i = 0; i < N; i++) {
            int a = by_tube ? i * count + k : k * N + i, b = by_tube ? a + 1 : a + N;
            theta[x][i] = rotation[a] * (1 + 2 * t) * u * u + rotation[b] * t * t * (3 - 2 * t) +
                          h * t * u * (torsion[a] * u - torsion[b] * t);
        }
    }
}

/* What was solved, into a pose. */
static void tell_loaded(const Bed *bed, const Answer *a, const tubeopt_joints *joints, tubeopt_pose *pose) {
    int tip = bed->pieces * STEPS;
    pose->joints = *joints;
    memcpy(pose->position, a->position[tip], sizeof pose->position);
    memcpy(pose->frame, a->frame[tip], sizeof pose->frame);
    for (int i = 0, k; i < N; i++) {
        for (k = 0; k < tip && a->arc_length[k] < bed->end[i] - ROUND_OFF_LENGTH; k++) {}
        pose->tip_rotations[i] = a->rotation[k][i];
    }
    pose->margin = a->margin;
    pose->energy = a->energy;
    pose->error = a->tip_error;
    pose->residual = a->residual;
}

/* The equilibrium under the whole load, grown from the unloaded one with these samples by tubes and this margin. 0, or 1
   where there is none, or it is not sure. */
int tubeopt_bearing_grow(void *room, const tubeopt_load *load, const tubeopt_joints *joints, int count, const double *s,
                         const double *rotation, const double *torsion, double margin, tubeopt_pose *pose) {
    Bearing *b = room;
    Bed *bed = b->beds + !b->here;
    double none[N] = {0};
    if (!lay_bed(bed, joints->translations, load)) return 1;
    lay_rules(b, bed, load);
    sample_arm(bed, count, s, rotation, torsion, 1, b->theta);
    Answer *next = b->answers + !b->here;
    if (solve_loaded(&b->rules, joints->rotations, none, b->theta[0], NULL, margin, &b->work, next)) return 1;
    tell_loaded(bed, next, joints, pose);
    return 0;
}

/* The equilibrium close to the last one. 0, or 1 where there is none. */
int tubeopt_bearing_step(void *room, const tubeopt_load *load, const tubeopt_joints *joints, tubeopt_pose *pose) {
    Bearing *b = room;
    const Bed *old = b->beds + b->here;
    Bed *bed = b->beds + !b->here;
    const Answer *last = b->answers + b->here;
    double turn[N];
    if (!lay_bed(bed, joints->translations, load)) return 1;
    lay_rules(b, bed, load);
    if (bed->pieces == old->pieces) {
        memcpy(b->theta, last->theta, sizeof b->theta);
        memcpy(b->curvature, last->curvature, sizeof b->curvature);
    } else {
        int tip = old->pieces * STEPS, k = 0;
        sample_arm(bed, tip + 1, last->arc_length, last->rotation[0], last->torsion[0], 0, b->theta);
        for (int x = 0; x < bed->pieces * DEGREE; x++) {
            double at = bed->start[x / DEGREE] + bed->length[x / DEGREE] * RULE[0].nodes[x % DEGREE];
            while (k + 2 < tip + 1 && last->arc_length[k + 1] <= at) k++;
            double t = fmin(fmax((at - last->arc_length[k]) / (last->arc_length[k + 1] - last->arc_length[k]), 0), 1);
            for (int j = 0; j < 2; j++) b->curvature[x][j] = (1 - t) * last->bent[k][j] + t * last->bent[k + 1][j];
        }
    }
    for (int i = 0; i < N; i++) turn[i] = joints->rotations[i] - b->joints.rotations[i];
    Answer *next = b->answers + !b->here;
    if (solve_loaded(&b->rules, joints->rotations, turn, b->theta[0], b->curvature[0], last->margin, &b->work, next))
        return 1;
    tell_loaded(bed, next, joints, pose);
    return 0;
}

/* What was solved last becomes what is gone on from. */
void tubeopt_bearing_accept(void *room, const tubeopt_joints *joints) {
    Bearing *b = room;
    b->here = !b->here;
    b->joints = *joints;
}

/* Compliance of the tip under the load (36). */
void tubeopt_bearing_compliance(const void *room, double *out) {
    const Bearing *b = room;
    memcpy(out, b->answers[b->here].compliance, sizeof b->answers[0].compliance);
}

/* Points along the arm; returns the last one's number. */
int tubeopt_bearing_arm(const void *room, const double **s, const double (**position)[3], const double (**frame)[9]) {
    const Bearing *b = room;
    const Answer *a = b->answers + b->here;
    *s = a->arc_length;
    *position = a->position;
    *frame = a->frame;
    return b->beds[b->here].pieces * STEPS;
}

/* The last equilibrium, to which a motion that fails returns. */
void tubeopt_bearing_keep(void *room) {
    Bearing *b = room;
    b->kept_bed = b->beds[b->here];
    b->kept = b->answers[b->here];
    b->kept_joints = b->joints;
}

void tubeopt_bearing_return(void *room) {
    Bearing *b = room;
    b->beds[b->here] = b->kept_bed;
    b->answers[b->here] = b->kept;
    b->joints = b->kept_joints;
}
