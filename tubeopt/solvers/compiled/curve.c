/* The piece of a curve (last + 1 points) in which arc length s lies. */
static int piece_at(const double *along, int last, double s) {
    int k = 0;
    while (k + 2 <= last && along[k + 1] <= s) k++;
    return k;
}

/* The centreline between two of its points, at arc length s: cubic, with the tangents. */
static void on_curve(const double *along, const double (*place)[3], const double (*frame)[9], int k, double s,
                     double *out) {
    double h = along[k + 1] - along[k], t = (s - along[k]) / h, u = 1 - t;
    for (int r = 0; r < 3; r++)
        out[r] = place[k][r] * (1 + 2 * t) * u * u + place[k + 1][r] * t * t * (3 - 2 * t) +
                 h * t * u * (frame[k][3 * r + 2] * u - frame[k + 1][3 * r + 2] * t);
}

