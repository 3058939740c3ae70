/*
 * What goes on between two communication points of a Co-Simulation: Dormand and Prince's pair of orders 5 and 4
 * (Journal of Computational and Applied Mathematics 6, 1980, table 2), inputs held as FMI 2.0 has them.
 */
#define STAGES 7
#define TOLERANCE 1e-8

/* A step of this share of the whole is taken whatever its error, as across a jump of dry friction: that a mass sticks
   would else take steps without end. */
#define SMALLEST 1e-4

static const double NODE[STAGES] = {0.0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0, 1.0};
static const double WEIGHT[STAGES][STAGES - 1] = {
    {0.0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0.0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
/* Of order 5 less that of order 4. */
static const double ERROR[STAGES] = {71.0 / 57600, 0.0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525,
                                     -1.0 / 40};

/* One step of length h to `to`; returns its error over what is allowed. */
static double tried(Model *m, double h, double rate[STAGES][N_STATE + 1], double *to)
{
    double worst = 0.0;
    size_t i, j, s;
    RHS(m->time, m->value, m->value + INPUTS, m->value + FACTORS, rate[0]);
    for (s = 1; s < STAGES; s++) {
        for (i = 0; i < N_STATE; i++) {
            double sum = 0.0;
            for (j = 0; j < s; j++) sum += WEIGHT[s][j] * rate[j][i];
            to[i] = m->value[i] + h * sum;
        }
        RHS(m->time + NODE[s] * h, to, m->value + INPUTS, m->value + FACTORS, rate[s]);
    }
    for (i = 0; i < N_STATE; i++) {
        double off = 0.0, size = fmax(m->largest[i], fabs(to[i]));
        for (s = 0; s < STAGES; s++) off += ERROR[s] * rate[s][i];
        off = fabs(h * off);
        if (!isfinite(off) || !isfinite(to[i])) return INFINITY;
        /* What has been at zero all along, and is there again, has no size to be compared with. */
        if (off > 0.0 && size > 0.0) worst = fmax(worst, off / (m->tolerance * size));
    }
    return worst;
}

/* The states at `end`; returns whether they are finite. */
static int advance(Model *m, double end)
{
    const double begin = m->time, least = SMALLEST * (end - begin);
    double rate[STAGES][N_STATE + 1], to[N_STATE + 1], h = fmin(fmax(m->step, least), end - begin);
    size_t i;
    for (i = 0; i < N_STATE; i++) m->largest[i] = fmax(m->largest[i], fabs(m->value[i]));
    while (m->time < end) {
        /* What is left is no step of its own if it is next to nothing. */
        const int last = m->time + h * (1 + 1e-9) >= end;
        const double length = last ? end - m->time : h;
        const double off = tried(m, length, rate, to);
        if (off > 1.0 && length > least) {
            h = fmax(least, length * fmax(0.2, 0.9 * pow(off, -0.2)));
            continue;
        }
        if (!(off < INFINITY)) return 0;
        memcpy(m->value, to, N_STATE * sizeof(double));
        for (i = 0; i < N_STATE; i++) m->largest[i] = fmax(m->largest[i], fabs(to[i]));
        m->time = last ? end : m->time + length;
        h = fmax(least, fmax(h, length) * (off > 0.0 ? fmin(5.0, fmax(0.2, 0.9 * pow(off, -0.2))) : 5.0));
    }
    m->step = h;
    return 1;
}
