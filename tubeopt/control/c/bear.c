
/* --- an arm under a dead force at its tip and its weight ---------------------------------------------------------- */

#define RULES 3

/* Mesh and cross-sections at joint values: what equilibrium/problem.py and block/transcription/mesh.py do. */
typedef struct {
    Layout layout;
    int tip_tube;
    double whole, beyond[MOST_PIECES], mass[MOST_PIECES];
    double bent[MOST_PIECES][N], felt[MOST_PIECES][N], held[N];
} Bed;

/* What a problem points to. */
typedef struct {
    Sections at[MOST_POINTS];
    double force[MOST_POINTS][3];
} Along;

/* An equilibrium on its mesh. */
typedef struct {
    Bed bed;
    Answer answer;
    tubeopt_pose pose;
} Borne;

typedef struct {
    Along along[RULES];
    Sections ends[(STEPS + 1) * MOST_PIECES];
    double ends_twist[(STEPS + 1) * MOST_PIECES][N], base_force[3];
    Rules rules;
    Workspace work;
    Borne borne[2], kept; /* the last equilibrium and room for the next, and that to which a motion that fails returns */
    int here;
    double theta[MOST_POINTS][N], curvature[MOST_POINTS][2], place[MOST_POINTS], moment[MOST_POINTS][2];
    Turning turning; /* about what was solved last, where it was found */
} Bearing;

size_t tubeopt_bearing_size(void) { return sizeof(Bearing); }

/* A section of the arm as a row of pieces, short enough for coupling, bend and force; 0 where there is no room. */
static int lay_section(Bed *bed, double from, double to, double force) {
    Layout *l = &bed->layout;
    Across here = across(&ROBOT, l, from, to);
    Needs needs = needs_of(&ROBOT, l, from, to - from, &here);
    double fast = sqrt(force / needs.softest), bend = fmin(2 * fast, force * bed->whole / needs.softest), mass = 0;
    double waves = fmax(fmax(needs.fastest, fast), sqrt(needs.pull * bend)) / LOADED_WAVES;
    double need = fmax(fmax(waves, (needs.steepest + bend) / BEND_PER_ELEMENT), needs.finest) * (to - from);
    int first = l->pieces;
    if (!add_pieces(&ROBOT, l, 0, from, to - from, fmax(1, ceil(need - 1e-9)), &here, 1)) return 0;
    for (int i = 0; i < N; i++) mass += here.present[i] ? MASS[i] : 0;
    for (int p = first; p < l->pieces; p++) {
        bed->mass[p] = mass;
        for (int i = 0; i < N; i++) bed->bent[p][i] = here.curved[i];
    }
    return 1;
}

static int lay_bed(Bed *bed, const double *shift, const tubeopt_load *load) {
    Layout *l = &bed->layout;
    double cuts[MOST_CUTS], weight = 0, force = sqrt(dot(load->force, load->force, 3));
    int count = cuts_of(&ROBOT, shift, l, cuts);
    if (count < 2) return 0;
    l->pieces = bed->tip_tube = 0;
    bed->whole = cuts[count - 1];
    memcpy(bed->held, l->held, sizeof bed->held);
    for (int i = 0; i < N; i++) weight += MASS[i] * fmax(l->end[i], 0);
    /* Of the tubes that end at the tip, the innermost. */
    while (l->end[bed->tip_tube] < bed->whole - SAME_END) bed->tip_tube++;
    force += weight * sqrt(dot(load->gravity, load->gravity, 3));
    for (int k = 0; k + 1 < count; k++)
        if (!lay_section(bed, cuts[k], cuts[k + 1], force)) return 0;
    double beyond = 0;
    for (int p = l->pieces - 1; p >= 0; p--) {
        bed->beyond[p] = beyond;
        beyond += bed->mass[p] * l->length[p];
        for (int i = 0; i < N; i++) /* twist matters up to where a tube bends for the last time, and to the tip */
            bed->felt[p][i] = i == bed->tip_tube || bed->bent[p][i] > 0 || (p + 1 < l->pieces && bed->felt[p + 1][i] > 0);
    }
    return 1;
}

/* A problem on a rule. */
static void lay_rule(Bearing *b, const Bed *bed, const tubeopt_load *load, int which, Problem *out) {
    const Rule *rule = RULE + which;
    const Layout *l = &bed->layout;
    Along *along = b->along + which;
    int k = rule->degree;
    for (int x = 0; x < l->pieces * k; x++) {
        int p = x / k;
        double mass = bed->beyond[p] + bed->mass[p] * l->length[p] * (1 - rule->nodes[x % k]);
        sections_on(&ROBOT, l, p, rule->nodes[x % k], &along->at[x]);
        for (int r = 0; r < 3; r++) along->force[x][r] = load->force[r] + mass * load->gravity[r];
    }
    *out = (Problem){l->pieces, bed->tip_tube, bed->whole, l->start, l->length, bed->bent[0], bed->felt[0], bed->held,
                     along->at, b->ends, b->ends_twist[0], along->force[0], b->base_force};
}

/* All three problems of a bed. */
static void lay_rules(Bearing *b, const Bed *bed, const tubeopt_load *load) {
    const Layout *l = &bed->layout;
    for (int x = 0; x < (STEPS + 1) * l->pieces; x++) {
        int p = x / (STEPS + 1);
        double at = (double)(x % (STEPS + 1)) / STEPS;
        sections_on(&ROBOT, l, p, at, &b->ends[x]);
        for (int i = 0; i < N; i++) b->ends_twist[x][i] = twist_on(&ROBOT, l, p, i, at);
    }
    double mass = bed->beyond[0] + bed->mass[0] * l->length[0];
    for (int r = 0; r < 3; r++) b->base_force[r] = load->force[r] + mass * load->gravity[r];
    lay_rule(b, bed, load, 0, &b->rules.problem);
    lay_rule(b, bed, load, 1, &b->rules.rough);
    lay_rule(b, bed, load, 2, &b->rules.check);
}

/* Elastic rotations at the points of a bed, from those of an arm on another one: the polynomial through the samples of each
   of its pieces, since rates jump between. */
static void sample_arm(const Bed *bed, const Layout *from, int pieces, const double *s, const double (*rotation)[N],
                       double theta[][N]) {
    const Layout *l = &bed->layout;
    int e = 0;
    for (int x = 0; x < l->pieces * DEGREE; x++) {
        int p = x / DEGREE;
        double at = l->start[p] + l->length[p] * RULE[0].nodes[x % DEGREE];
        while (e + 1 < pieces && s[(e + 1) * STEPS] <= at) e++;
        double low = s[e * STEPS], t = STEPS * fmin(fmax((at - low) / (s[(e + 1) * STEPS] - low), 0), 1);
        memset(theta[x], 0, sizeof theta[x]);
        for (int k = 0; k <= STEPS; k++) {
            double basis = 1;
            for (int j = 0; j <= STEPS; j++) basis *= j == k ? 1 : (t - j) / (k - j);
            for (int i = 0; i < N; i++)
                theta[x][i] += basis * (rotation[e * STEPS + k][i] - twist_angle_at(&PIECES, i, s[e * STEPS + k] + from->transmission[i]));
        }
    }
}

/* Curvature without load of a cross-section whose tubes are at theta (N); returns its stiffness. */
static double natural_at(const Layout *l, int p, double x, const double *theta, double *out) {
    double sum = 0;
    Sections here;
    sections_on(&ROBOT, l, p, x, &here);
    bend_freely(&here, theta, out);
    for (int i = 0; i < N; i++) sum += here.stiffness[i];
    return sum;
}

/* Curvature at the points of a mesh from those of another one, by the bending moment, which does not jump. */
static void sample_bend(Bearing *b, const Layout *old, const Answer *last, const Layout *l) {
    int count = old->pieces * DEGREE, k = 0;
    double natural[2];
    for (int x = 0; x < count; x++) {
        double node = RULE[0].nodes[x % DEGREE], stiffness = natural_at(old, x / DEGREE, node, last->theta[x], natural);
        b->place[x] = old->start[x / DEGREE] + old->length[x / DEGREE] * node;
        for (int j = 0; j < 2; j++) b->moment[x][j] = stiffness * (last->curvature[x][j] - natural[j]);
    }
    for (int x = 0; x < l->pieces * DEGREE; x++) {
        double node = RULE[0].nodes[x % DEGREE], at = l->start[x / DEGREE] + l->length[x / DEGREE] * node;
        double stiffness = natural_at(l, x / DEGREE, node, b->theta[x], natural);
        while (k + 2 < count && b->place[k + 1] <= at) k++;
        double t = fmin(fmax((at - b->place[k]) / (b->place[k + 1] - b->place[k]), 0), 1);
        for (int j = 0; j < 2; j++)
            b->curvature[x][j] = natural[j] + ((1 - t) * b->moment[k][j] + t * b->moment[k + 1][j]) / stiffness;
    }
}

/* What was solved at joint values, as a pose. */
static void pose_borne(Borne *borne, const tubeopt_joints *joints) {
    const Bed *bed = &borne->bed;
    const Answer *a = &borne->answer;
    tubeopt_pose *pose = &borne->pose;
    int tip = bed->layout.pieces * STEPS;
    pose->joints = *joints;
    memcpy(pose->position, a->position[tip], sizeof pose->position);
    memcpy(pose->frame, a->frame[tip], sizeof pose->frame);
    for (int i = 0; i < N; i++) pose->tip_rotations[i] = a->rotation[ending(&bed->layout, i) * STEPS][i];
    pose->margin = a->margin;
    pose->energy = a->energy;
    pose->error = a->tip_error;
    pose->residual = a->residual;
}

/* The equilibrium under the whole load, grown from the unloaded one of this margin, whose rotations along its pieces are
   given. 0, or 1 where there is none, or it is not sure. */
int tubeopt_bearing_grow(void *room, const tubeopt_load *load, const tubeopt_joints *joints, int pieces, const double *s,
                         const double (*rotation)[N], double margin) {
    Bearing *b = room;
    Borne *next = b->borne + !b->here;
    Bed *bed = &next->bed;
    double none[N] = {0};
    if (!lay_bed(bed, joints->translations, load)) return 1;
    lay_rules(b, bed, load);
    sample_arm(bed, &bed->layout, pieces, s, rotation, b->theta);
    if (solve_loaded(&b->rules, joints->rotations, none, b->theta[0], NULL, margin, &b->work, &next->answer)) return 1;
    pose_borne(next, joints);
    return 0;
}

/* The equilibrium close to the last one. 0, or 1 where there is none. */
int tubeopt_bearing_step(void *room, const tubeopt_load *load, const tubeopt_joints *joints) {
    Bearing *b = room;
    const Borne *now = b->borne + b->here;
    Borne *next = b->borne + !b->here;
    const Bed *old = &now->bed;
    Bed *bed = &next->bed;
    const Answer *last = &now->answer;
    double turn[N];
    if (!lay_bed(bed, joints->translations, load)) return 1;
    lay_rules(b, bed, load);
    if (bed->layout.pieces == old->layout.pieces) {
        memcpy(b->theta, last->theta, sizeof b->theta);
        memcpy(b->curvature, last->curvature, sizeof b->curvature);
    } else {
        sample_arm(bed, &old->layout, old->layout.pieces, last->arc_length, last->rotation, b->theta);
        sample_bend(b, &old->layout, last, &bed->layout);
    }
    for (int i = 0; i < N; i++) turn[i] = joints->rotations[i] - now->pose.joints.rotations[i];
    if (solve_loaded(&b->rules, joints->rotations, turn, b->theta[0], b->curvature[0], last->margin, &b->work, &next->answer))
        return 1;
    pose_borne(next, joints);
    return 0;
}

/* Prepares proofs about the equilibrium that was solved last and not accepted; 0 where there is no room for them. */
int tubeopt_bearing_couple(void *room) {
    Bearing *b = room;
    Workspace *w = &b->work;
    const double *alpha = b->borne[!b->here].pose.joints.rotations;
    return N <= 4 && find_turning(&w->stage, &w->state, alpha, &w->step, &w->other_step, &b->turning);
}

/* Whether turns of all tubes by up to r, each either way, are then proved to cause no snap. */
int tubeopt_bearing_turns(void *room, double r) {
    Bearing *b = room;
    return proves_turn(&b->work.stage, &b->work.state, &b->turning, r);
}

/* The largest such turn, at most `most`, to a relative precision. */
double tubeopt_bearing_turn(void *room, double most, double precision) {
    Bearing *b = room;
    return largest_turn_of(&b->work.stage, &b->work.state, &b->turning, most, precision);
}

/* What was solved last becomes what is gone on from. */
void tubeopt_bearing_accept(void *room) {
    Bearing *b = room;
    b->here = !b->here;
}

/* The last equilibrium, or the `next` one, which was solved for and not accepted. */
const tubeopt_pose *tubeopt_bearing_pose(const void *room, int next) {
    const Bearing *b = room;
    return &b->borne[next ? !b->here : b->here].pose;
}

/* Compliance of the tip (36) at the last equilibrium. */
void tubeopt_bearing_compliance(const void *room, double *out) {
    const Bearing *b = room;
    memcpy(out, b->borne[b->here].answer.compliance, 36 * sizeof(double));
}

/* Points along the arm; returns the last one's number. */
int tubeopt_bearing_arm(const void *room, const double **s, const double (**position)[3], const double (**frame)[9]) {
    const Bearing *b = room;
    const Answer *a = &b->borne[b->here].answer;
    *s = a->arc_length;
    *position = a->position;
    *frame = a->frame;
    return b->borne[b->here].bed.layout.pieces * STEPS;
}

/* The last equilibrium, to which a motion that fails returns. */
void tubeopt_bearing_keep(void *room) {
    Bearing *b = room;
    b->kept = b->borne[b->here];
}

void tubeopt_bearing_return(void *room) {
    Bearing *b = room;
    b->borne[b->here] = b->kept;
}
