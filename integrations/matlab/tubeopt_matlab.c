/* See tubeopt_matlab.h. */
#include "tubeopt_matlab.h"

#include <stdlib.h>
#include <string.h>

#include "tubeopt_robot.h"

enum { N = TUBEOPT_TUBES };

static tubeopt_memory *robot(void) {
    static tubeopt_memory *memory;
    if (!memory) {
        void *room = malloc(tubeopt_memory_size());
        memory = room ? tubeopt_start(room) : NULL;
    }
    return memory;
}

static tubeopt_joints joints_of(const double *joints) {
    tubeopt_joints found;
    memcpy(found.rotations, joints, sizeof found.rotations);
    memcpy(found.translations, joints + N, sizeof found.translations);
    return found;
}

static int written(tubeopt_status status, const tubeopt_pose *from, double *pose) {
    if (status != TUBEOPT_DONE) return status;
    memcpy(pose, from->position, sizeof from->position);
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++) pose[3 + 3 * column + row] = from->frame[3 * row + column];
    pose[12] = from->margin;
    pose[13] = from->energy;
    return status;
}

int tubeopt_matlab_tubes(void) { return N; }

int tubeopt_matlab_solve(const double *joints, double *pose) {
    tubeopt_pose found;
    tubeopt_joints given = joints_of(joints);
    return robot() ? written(tubeopt_solve(robot(), &given, &found), &found, pose) : TUBEOPT_NOT_STARTED;
}

int tubeopt_matlab_follow(const double *joints, double *pose) {
    tubeopt_pose found;
    tubeopt_joints given = joints_of(joints);
    return robot() ? written(tubeopt_follow(robot(), &given, &found), &found, pose) : TUBEOPT_NOT_STARTED;
}

int tubeopt_matlab_undo(double *pose) {
    tubeopt_pose found;
    return robot() ? written(tubeopt_undo(robot(), &found), &found, pose) : TUBEOPT_NOT_STARTED;
}

int tubeopt_matlab_jacobian(double *jacobian) {
    tubeopt_slopes found;
    if (!robot()) return TUBEOPT_NOT_STARTED;
    tubeopt_status status = tubeopt_slopes_at(robot(), &found);
    if (status != TUBEOPT_DONE) return status;
    for (int k = 0; k < TUBEOPT_JOINTS; k++)
        for (int axis = 0; axis < 3; axis++) {
            jacobian[6 * k + axis] = found.position[axis][k];
            jacobian[6 * k + 3 + axis] = found.turn[axis][k];
        }
    return status;
}

int tubeopt_matlab_shape(int count, double *points) {
    if (!robot()) return TUBEOPT_NOT_STARTED;
    if (count < 2) return TUBEOPT_BAD_INPUT;
    double *along = malloc((size_t)count * sizeof *along);
    if (!along) return TUBEOPT_TOO_LARGE;
    tubeopt_status status = tubeopt_shape(robot(), count, along, (double(*)[3])points);
    free(along);
    return status;
}

int tubeopt_matlab_servo(const double *command, double *joints, double *pose, double *report) {
    tubeopt_pose found;
    tubeopt_report told;
    if (!robot()) return TUBEOPT_NOT_STARTED;
    tubeopt_command asked = {
        .step = command[0],
        .position = {command[1], command[2], command[3]},
        .direction = {command[4], command[5], command[6]},
        .speed = command[7],
        .turn_rate = command[8],
        .shift_rate = command[9],
        .min_margin = command[10],
        .push = command[11],
    };
    tubeopt_status status = tubeopt_servo(robot(), &asked, &found, &told);
    if (written(status, &found, pose) != TUBEOPT_DONE) return status;
    memcpy(joints, found.joints.rotations, sizeof found.joints.rotations);
    memcpy(joints + N, found.joints.translations, sizeof found.joints.translations);
    report[0] = told.distance;
    report[1] = told.angle;
    report[2] = told.why;
    return status;
}
