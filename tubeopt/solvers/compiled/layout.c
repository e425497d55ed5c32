/* Joint values -> sections -> pieces of the mesh: what robots/assembly.py and transcription/mesh.py do. */

typedef struct {
    int pieces, sections, tubes_shown;
    double start[MOST_PIECES], length[MOST_PIECES];
    int section[MOST_PIECES], collocated[MOST_PIECES];
    double stiffness[MOST_PIECES][N], moment[MOST_PIECES][N];
    int present[MOST_PIECES][N], curved[MOST_PIECES][N];
    double transmission[N], end[N], section_start[2 * N + 1];
} Layout;

typedef struct {
    double kb[N], kt[N], curvature[N], straight[N], whole[N], offset[N], angle[N];
    int eccentric;
} Tubes;

static int compare(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Bound of the fastest growth of torsion, 1/m: row sums of the Jacobi matrix. */
static double coupling_rate(const Tubes *t, const double *moment, const double *stiffness) {
    double total = 0, worst = 0;
    for (int i = 0; i < N; i++) total += stiffness[i];
    if (total <= 0) return 0;
    for (int i = 0; i < N; i++) {
        double row = 0;
        for (int j = 0; j < N; j++)
            if (j != i) row += fabs(moment[i] * moment[j]) / total * (1 / t->kt[i] + 1 / t->kt[j]);
        worst = fmax(worst, row);
    }
    return sqrt(worst);
}

/* Cut the arm at every transition and end in front of the plate; 0 where that cannot be. */
static int cuts_of(const Tubes *t, const double *shift, Layout *l, double *transition, double *cuts) {
    int count = 0, kept = 1;
    cuts[count++] = 0;
    for (int i = 0; i < N; i++) {
        if (!(shift[i] - t->straight[i] <= ROUND_OFF_LENGTH)) return 0; /* out of its actuator */
        double beta = fmin(shift[i] - t->straight[i], 0.0);
        l->transmission[i] = -beta;
        transition[i] = beta + t->straight[i];
        l->end[i] = beta + t->whole[i];
        cuts[count++] = fmax(transition[i], 0.0);
        cuts[count++] = fmax(l->end[i], 0.0);
    }
    qsort(cuts, count, sizeof(double), compare);
    for (int k = 1; k < count; k++)
        if (cuts[k] - cuts[kept - 1] > ROUND_OFF_LENGTH) cuts[kept++] = cuts[k];
    return kept;
}

static int lay_out(const Tubes *t, const double *shift, Layout *l) {
    double transition[N], cuts[2 * N + 1];
    int count = cuts_of(t, shift, l, transition, cuts);
    if (!count) return 0;
    l->pieces = 0;
    l->sections = count - 1;
    for (int k = 0; k + 1 < count; k++) {
        double length = cuts[k + 1] - cuts[k], middle = (cuts[k] + cuts[k + 1]) / 2, steepest = 0;
        double kb[N], m[N];
        int present[N], curved[N], bent = 0;
        l->section_start[k] = cuts[k];
        for (int i = 0; i < N; i++) {
            present[i] = middle < l->end[i];
            curved[i] = present[i] && middle > transition[i] && t->curvature[i] != 0;
            kb[i] = present[i] ? t->kb[i] : 0;
            m[i] = curved[i] ? t->kb[i] * t->curvature[i] : 0;
            bent += curved[i];
            if (curved[i]) steepest = fmax(steepest, fabs(t->curvature[i]));
        }
        double need = fmax(coupling_rate(t, m, kb) * length / WAVES_PER_ELEMENT, steepest * length / BEND_PER_PIECE);
        double wanted = bent ? fmax(1.0, ceil(need - 1e-9)) : 1.0;
        if (l->pieces + wanted > MOST_PIECES) return 0;
        int pieces = (int)wanted;
        for (int j = 0; j < pieces; j++) {
            int p = l->pieces++;
            l->length[p] = length / pieces;
            l->start[p] = cuts[k] + j * l->length[p];
            l->section[p] = k;
            l->collocated[p] = bent >= (t->eccentric ? 1 : 2);
            memcpy(l->stiffness[p], kb, sizeof kb);
            memcpy(l->moment[p], m, sizeof m);
            memcpy(l->present[p], present, sizeof present);
            memcpy(l->curved[p], curved, sizeof curved);
        }
    }
    return l->pieces > 0;
}
