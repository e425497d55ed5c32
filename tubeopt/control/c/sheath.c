/* --- tubes in the channels of a sheath, at any translations -------------------------------------------------------- */

#define FLAT (1 - 1e-9) /* margin above which nothing softens */

typedef struct {
    double kb[N], kt[N], curvature[N], offset[N], angle[N], lever[N][2], straight[N], curved[N], whole[N], sheath;
} Robot;

/* The workspace of the kernel, with what it starts from. */
typedef struct {
    Workspace kernel;
    Tubes tubes;
    double near[sizeof(Start) / sizeof(double) + MOST_POINTS * (N + 2)];
} Room;

/* Tubes in front of the plate at translations: a boundary where one ends or begins to curve, one for all of a place. */
static void put_in(const Robot *r, const double *shift, Tubes *t) {
    int count = 0;
    memset(t, 0, sizeof *t);
    memcpy(t->kb, r->kb, sizeof t->kb);
    memcpy(t->kt, r->kt, sizeof t->kt);
    memcpy(t->offset, r->offset, sizeof t->offset);
    memcpy(t->angle, r->angle, sizeof t->angle);
    memcpy(t->lever, r->lever, sizeof t->lever);
    t->sheath = r->sheath;
    for (int i = 0; i < N; i++) {
        double behind = fmax(r->straight[i] - shift[i], 0);
        t->moment[i] = r->kb[i] * r->curvature[i];
        t->behind[i] = behind > SAME_PLACE ? behind : 0;
    }
    for (int k = 0; k < 2 * N; k++) {
        int i = k % N, ends = k >= N, at = 0;
        double place = ends ? shift[i] + r->curved[i] : shift[i];
        if (place <= SAME_PLACE || (!ends && r->curvature[i] == 0)) continue;
        for (; at < count; at++) {
            const double *other = r->lever[(int)t->boundary[at].tube];
            double apart = fmax(fabs(other[0] - r->lever[i][0]), fabs(other[1] - r->lever[i][1]));
            if (fabs(t->boundary[at].arc_length - place) + apart <= SAME_PLACE) break;
        }
        Boundary *b = t->boundary + at;
        if (at == count) {
            b->arc_length = place;
            b->tube = i;
            count++;
        }
        b->tube = fmin(b->tube, i);
        if (ends)
            b->ends[i] = 1, b->begins[i] = 0;
        else
            b->begins[i] = 1;
    }
    t->boundaries = count;
}

/* Whether an arm is as exact as Python asks for. */
static int is_fine(const Answer *a) {
    return a->theta_error <= TOLERANCE && a->tip_error <= TOLERANCE * a->arc_length[a->pieces * STEPS];
}

/* The stable equilibrium at joint values, from tubes without torsion. */
static int solve(const Robot *r, const double *alpha, const double *shift, const void *guess, Room *room, Answer *out) {
    (void)guess;
    put_in(r, shift, &room->tubes);
    for (int halvings = 0; halvings < 2 && room->tubes.boundaries > 0; halvings++) {
        if (solve_bundle(&room->tubes, alpha, NULL, halvings, &room->kernel, out)) return DECLINED;
        if (is_fine(out)) return SOLVED;
    }
    return DECLINED;
}

/* The largest difference of the twists of two arms at the same arc lengths, rad. */
static double apart(const Answer *one, const double *alpha, const Answer *other, const double *other_alpha) {
    int last = (int)other->pieces * STEPS, k = 0;
    double out = 0;
    for (int x = 0; x <= one->pieces * STEPS; x++) {
        double s = fmin(one->arc_length[x], other->arc_length[last]), t;
        while (k + 2 <= last && other->arc_length[k + 1] <= s) k++;
        t = (s - other->arc_length[k]) / (other->arc_length[k + 1] - other->arc_length[k]);
        for (int i = 0; i < N; i++) {
            double there = (1 - t) * other->rotation[k][i] + t * other->rotation[k + 1][i] - other_alpha[i];
            out = fmax(out, fabs(one->rotation[x][i] - alpha[i] - there));
        }
    }
    return out;
}

/* The equilibrium at joint values a small step from those of the last one: 0, or 1 where it is not small or Newton's method is
   not at ease. */
static int small_step(const Robot *r, const Answer *last, const double *alpha, const double *shift, const double *to_alpha,
                      const double *to_shift, Room *room, Answer *next) {
    Start *from = (Start *)room->near;
    int points = (int)last->pieces * DEGREE, before = 0;
    memset(from, 0, sizeof *from);
    from->sections = last->sections;
    for (int j = 0; j < last->sections; j++) {
        int after = before;
        from->end[j] = j + 1 < last->sections ? last->section_start[j + 1] : last->arc_length[last->pieces * STEPS];
        while (after < last->pieces && last->point[after * DEGREE] < from->end[j]) after++;
        from->pieces[j] = after - before;
        before = after;
    }
    for (int i = 0; i < N; i++) {
        from->rotations[i] = alpha[i];
        from->twist[i] = last->rotation[0][i] - alpha[i];
        from->shift[i] = to_shift[i] - shift[i];
    }
    memcpy(from->points, last->theta, points * sizeof last->theta[0]);
    memcpy(from->points + points * N, last->bent, points * sizeof last->bent[0]);
    put_in(r, to_shift, &room->tubes);
    if (!(room->tubes.boundaries > 0)) return 1;
    if (solve_bundle(&room->tubes, to_alpha, from, 0, &room->kernel, next)) {
        /* The ends of two tubes may have to pass each other: what lies as close by as a soft branch does is its continuation. */
        if (solve(r, to_alpha, to_shift, NULL, room, next) || apart(next, to_alpha, last, alpha) > SOFT_TWIST) return 1;
        return next->margin < last->margin / 2;
    }
    /* Where a branch ends and another one begins close by, only the margin shows a step across the gap. */
    if (next->margin < last->margin / 2 || !is_fine(next)) return 1;
    return next->contraction > LARGEST_RATIO || next->largest_change > LONGEST_TWIST(last->margin);
}

#define Workspace Room
