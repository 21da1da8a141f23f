/* Kinematics of a hexapod by the conventions that LinuxCNC's manual states for genhexkins, written for the tests.
 *
 * Reads HAL lines "setp genhexkins.base.N.x VALUE" from the file named first, then from standard input either
 * "inverse x y z a b c" (machine units, degrees) and prints six strut lengths, or
 * "forward l0 .. l5 x y z a b c" (lengths, and a pose to start from) and prints the pose.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#define DEGREE (3.14159265358979323846 / 180.0)

static double base[6][3], platform[6][3];

static int read_pins(const char *name)
{
    char line[256], part[32], axis;
    int strut, found = 0;
    double value;
    FILE *file = fopen(name, "r");
    if (!file) return 0;
    while (fgets(line, sizeof line, file)) {
        if (sscanf(line, "setp genhexkins.%31[a-z].%d.%c %lf", part, &strut, &axis, &value) != 4) continue;
        if (strut < 0 || strut > 5 || axis < 'x' || axis > 'z') return 0;
        (strcmp(part, "base") ? platform : base)[strut][axis - 'x'] = value;
        found++;
    }
    fclose(file);
    return found == 36;
}

/* length of every strut at a pose: |p + R platform - base|, R = Rz(c) Ry(b) Rx(a) */
static void measure(const double pose[6], double length[6])
{
    double a = pose[3] * DEGREE, b = pose[4] * DEGREE, c = pose[5] * DEGREE;
    for (int i = 0; i < 6; i++) {
        double x = platform[i][0], y = platform[i][1], z = platform[i][2], t, d[3];
        t = cos(a) * y - sin(a) * z; z = sin(a) * y + cos(a) * z; y = t;  /* about x */
        t = cos(b) * x + sin(b) * z; z = -sin(b) * x + cos(b) * z; x = t; /* about y */
        t = cos(c) * x - sin(c) * y; y = sin(c) * x + cos(c) * y; x = t;  /* about z */
        d[0] = pose[0] + x - base[i][0]; d[1] = pose[1] + y - base[i][1]; d[2] = pose[2] + z - base[i][2];
        length[i] = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    }
}

/* Newton's method with central differences and Gaussian elimination; 0 where it does not converge */
static int solve(const double wanted[6], double pose[6])
{
    for (int step = 0; step < 50; step++) {
        double here[6], more[6], less[6], m[6][7], size = 0.0;
        measure(pose, here);
        for (int k = 0; k < 6; k++) {
            double kept = pose[k], h = 1e-3;
            pose[k] = kept + h; measure(pose, more);
            pose[k] = kept - h; measure(pose, less);
            pose[k] = kept;
            for (int i = 0; i < 6; i++) m[i][k] = (more[i] - less[i]) / (2 * h);
        }
        for (int i = 0; i < 6; i++) { m[i][6] = wanted[i] - here[i]; size += fabs(m[i][6]); }
        if (size < 1e-11) return 1;
        for (int k = 0; k < 6; k++) {
            int best = k;
            for (int i = k + 1; i < 6; i++) if (fabs(m[i][k]) > fabs(m[best][k])) best = i;
            if (m[best][k] == 0.0) return 0;
            for (int j = 0; j < 7; j++) { double t = m[k][j]; m[k][j] = m[best][j]; m[best][j] = t; }
            for (int i = 0; i < 6; i++) {
                if (i == k) continue;
                double f = m[i][k] / m[k][k];
                for (int j = k; j < 7; j++) m[i][j] -= f * m[k][j];
            }
        }
        for (int k = 0; k < 6; k++) pose[k] += m[k][6] / m[k][k];
    }
    return 0;
}

int main(int count, char **names)
{
    char what[16];
    double v[12], out[6];
    if (count != 2 || !read_pins(names[1])) return 1;
    while (scanf("%15s", what) == 1) {
        int n = strcmp(what, "forward") ? 6 : 12;
        for (int i = 0; i < n; i++) if (scanf("%lf", &v[i]) != 1) return 2;
        if (n == 6) measure(v, out);
        else { if (!solve(v, v + 6)) return 3; memcpy(out, v + 6, sizeof out); }
        for (int i = 0; i < 6; i++) printf("%.17g%c", out[i], i < 5 ? ' ' : '\n');
    }
    return 0;
}
