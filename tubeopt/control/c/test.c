/* Answers of tubeopt itself, derivatives against differences, the guard, and how long a servo step takes. */
#define _POSIX_C_SOURCE 200112L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "tubeopt_robot.h"

#if !defined(CLOCK_THREAD_CPUTIME_ID) && !defined(_WIN32) /* WebAssembly knows no processor time */
#define CLOCK_THREAD_CPUTIME_ID CLOCK_MONOTONIC
#endif
#define N TUBEOPT_TUBES
#define STEPS 20000
#define ENOUGH 1000    /* steps, after which a servo stops that has taken so long: */
#define LONG_ENOUGH 3e6 /* us */

/* Joints, tip position, margin. */
static const double CASES[][2 * N + 4] = {
{CASES}};

#if TUBEOPT_LOADS
/* Joints, force, gravity, tip position, margin. */
static const double LOADED[][2 * N + 10] = {
{LOADED}};
#endif

static int failures = 0;

static void check(int holds, const char *what) {
    if (holds) return;
    failures++;
    printf("FAILED: %s\n", what);
}

static double distance(const double *a, const double *b) {
    return sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
}

static tubeopt_joints joints_of(const double *row) {
    tubeopt_joints joints;
    memcpy(joints.rotations, row, sizeof joints.rotations);
    memcpy(joints.translations, row + N, sizeof joints.translations);
    return joints;
}

static void known_answers(tubeopt_memory *robot) {
    for (size_t k = 0; k < sizeof CASES / sizeof CASES[0]; k++) {
        tubeopt_joints joints = joints_of(CASES[k]);
        tubeopt_pose pose;
        check(tubeopt_solve(robot, &joints, &pose) == TUBEOPT_DONE, "a known configuration is solved");
        check(distance(pose.position, CASES[k] + 2 * N) < 1e-9, "its tip is within 1 nm");
        check(fabs(pose.margin - CASES[k][2 * N + 3]) < 1e-6, "its margin is known");
    }
}

/* Derivatives by rotations against central differences. */
static void slopes(tubeopt_memory *robot) {
    tubeopt_joints joints = joints_of(CASES[0]);
    tubeopt_slopes slopes;
    tubeopt_pose ahead, behind;
    tubeopt_solve(robot, &joints, &ahead);
    check(tubeopt_slopes_at(robot, &slopes) == TUBEOPT_DONE, "there are derivatives");
    for (int i = 0; i < N; i++) {
        const double h = 1e-4;
        joints.rotations[i] += h;
        check(tubeopt_follow(robot, &joints, &ahead) == TUBEOPT_DONE, "the branch leads ahead");
        joints.rotations[i] -= 2 * h;
        check(tubeopt_follow(robot, &joints, &behind) == TUBEOPT_DONE, "the branch leads back");
        joints.rotations[i] += h;
        for (int r = 0; r < 3; r++) {
            double difference = (ahead.position[r] - behind.position[r]) / (2 * h);
            check(fabs(difference - slopes.position[r][i]) < 1e-7, "the tip moves as its derivative says");
        }
#if TUBEOPT_COMPLIANCE
        for (int a = 0; a < 6; a++)
            for (int b = 0; b < a; b++)
                check(fabs(slopes.compliance[a][b] - slopes.compliance[b][a]) <
                          1e-9 * sqrt(slopes.compliance[a][a] * slopes.compliance[b][b]),
                      "the compliance is symmetric");
#endif
    }
}

static void bad_input(tubeopt_memory *robot) {
    tubeopt_joints joints = joints_of(CASES[0]);
    tubeopt_pose pose;
    tubeopt_report report;
    tubeopt_command command = {.step = 1e-3, .speed = NAN};
    joints.rotations[0] = NAN;
    check(tubeopt_solve(robot, &joints, &pose) == TUBEOPT_BAD_INPUT, "a rotation that is no number is refused");
    check(tubeopt_servo(robot, &command, &pose, &report) == TUBEOPT_BAD_INPUT, "so is a command");
    joints = joints_of(CASES[0]);
    joints.translations[0] = 10;
    check(tubeopt_follow(robot, &joints, &pose) == TUBEOPT_BAD_INPUT, "and a tube out of its actuator");
    joints = joints_of(CASES[0]);
    joints.rotations[N - 1] = -1e308;
    check(tubeopt_solve(robot, &joints, &pose) == TUBEOPT_TOO_LARGE, "a rotation of 1e308 rad is too large");
    check(tubeopt_follow(robot, &joints, &pose) == TUBEOPT_TOO_LARGE, "to be followed as well");
    command = (tubeopt_command){.step = 1e-3, .speed = 1, .position = {1e308, 0, 0}};
    check(tubeopt_servo(robot, &command, &pose, &report) == TUBEOPT_TOO_LARGE, "so is a place 1e308 m away");
    command.position[0] = 190;
    check(tubeopt_servo(robot, &command, &pose, &report) == TUBEOPT_TOO_LARGE, "and one in mm");
    tubeopt_start(robot);
    joints = joints_of(CASES[0]);
    check(tubeopt_follow(robot, &joints, &pose) == TUBEOPT_NOT_STARTED, "nothing is followed before it is solved");
}

static int compare(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Processor time of the thread, us; on Windows that of the clock on the wall, since C has no other there. */
static double now(void) {
    struct timespec time;
#ifdef _WIN32
    timespec_get(&time, TIME_UTC);
#else
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
#endif
    return 1e6 * time.tv_sec + 1e-3 * time.tv_nsec;
}

/* Targets here and there, far out of reach too: rates and the floor are kept, and no step takes long. */
static void servo(tubeopt_memory *robot, int steps) {
    static double took[STEPS];
    tubeopt_joints joints = joints_of(CASES[0]), last;
    tubeopt_pose pose;
    tubeopt_report report;
    tubeopt_command command = {.step = 1e-3, .speed = 0.1, .turn_rate = 3, .shift_rate = 0.1, .min_margin = 0.2};
    unsigned state = 1;
    double total = 0;
    check(tubeopt_solve(robot, &joints, &pose) == TUBEOPT_DONE, "the servo has a start");
    double reach = sqrt(pose.position[0] * pose.position[0] + pose.position[1] * pose.position[1] +
                        pose.position[2] * pose.position[2]);
    for (int k = 0; k < steps; k++) {
        if (k >= ENOUGH && total > LONG_ENOUGH) { steps = k; break; }
        if (k % 500 == 0)
            for (int r = 0; r < 3; r++) {
                state = state * 1664525u + 1013904223u;
                command.position[r] = reach * (state / 4294967296.0 * 2.4 - (r < 2 ? 1.2 : 0.8));
            }
        last = pose.joints;
        double before = now();
        check(tubeopt_servo(robot, &command, &pose, &report) == TUBEOPT_DONE, "a step is answered");
        took[k] = now() - before;
        total += took[k];
        check(pose.margin >= 0.2, "the floor of the margin is kept");
        if (k == 10) { /* was not sent */
            check(tubeopt_undo(robot, &pose) == TUBEOPT_DONE, "a step is taken back");
            check(!memcmp(&pose.joints, &last, sizeof last), "the robot is where it was before");
            check(tubeopt_undo(robot, &pose) == TUBEOPT_NOT_STARTED, "no step is taken back twice");
        }
        for (int i = 0; i < N; i++) {
            check(fabs(pose.joints.rotations[i] - last.rotations[i]) < 3e-3 + 1e-12, "no joint turns too fast");
            check(fabs(pose.joints.translations[i] - last.translations[i]) < 1e-4 + 1e-12, "no joint moves too fast");
        }
    }
    qsort(took, steps, sizeof(double), compare);
    printf("servo step, processor time: %.0f us in the median, %.0f us at 99.9 %%, %.0f us at most\n", took[steps / 2],
           took[steps - steps / 1000], took[steps - 1]);
}

#if TUBEOPT_LOADS
/* Known answers under load, what the compliance says of a little more of it, and the way back. */
static void loads(tubeopt_memory *robot) {
    const tubeopt_load none = {{0, 0, 0}, {0, 0, 0}};
    for (size_t k = 0; k < sizeof LOADED / sizeof LOADED[0]; k++) {
        const double *row = LOADED[k];
        tubeopt_joints joints = joints_of(row);
        tubeopt_load load;
        tubeopt_pose free, pose, more;
        tubeopt_slopes slopes;
        memcpy(&load, row + 2 * N, sizeof load);
        check(tubeopt_solve(robot, &joints, &free) == TUBEOPT_DONE, "a known configuration is solved");
        check(tubeopt_bear(robot, &load, &pose) == TUBEOPT_DONE, "it bears its load");
        check(distance(pose.position, row + 2 * N + 6) < 1e-9, "the loaded tip is within 1 nm");
        check(fabs(pose.margin - row[2 * N + 9]) < (row[2 * N + 9] > 0.99 ? 1e-3 : 1e-5), "the loaded margin is known");
        check(tubeopt_slopes_at(robot, &slopes) == TUBEOPT_DONE, "there are derivatives under load");
        load.force[0] += 1e-6;
        check(tubeopt_bear(robot, &load, &more) == TUBEOPT_DONE, "it bears a little more");
        for (int r = 0; r < 3; r++)
            check(fabs((more.position[r] - pose.position[r]) / 1e-6 - slopes.compliance[r][0]) <
                      1e-3 * fabs(slopes.compliance[0][0]),
                  "the tip gives way as its compliance says");
        check(tubeopt_bear(robot, &none, &pose) == TUBEOPT_DONE, "the load is taken off");
        check(distance(pose.position, free.position) < 1e-12, "the tip is back");
        if (k) continue;
        tubeopt_bear(robot, &load, &pose);
        printf("under load: ");
        servo(robot, STEPS / 5);
        tubeopt_bear(robot, &none, &pose);
    }
}
#endif

int main(void) {
    tubeopt_memory *robot = tubeopt_start(malloc(tubeopt_memory_size()));
    known_answers(robot);
    slopes(robot);
    servo(robot, STEPS);
#if TUBEOPT_LOADS
    loads(robot);
#endif
    bad_input(robot);
    free(robot);
    printf("%s\n", failures ? "failed" : "passed");
    return failures != 0;
}
