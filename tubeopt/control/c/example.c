/* Moves the tip of {name} around a circle at 1 kHz, then against a wall. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tubeopt_robot.h"

int main(void) {
    tubeopt_memory *robot = tubeopt_start(malloc(tubeopt_memory_size())); /* the only memory that is allocated */
    tubeopt_joints joints = { {START} };
    tubeopt_pose pose;
    tubeopt_report report;
    if (tubeopt_solve(robot, &joints, &pose)) return 1;
    printf("tip (mm): %.4f %.4f %.4f, margin %.4f\n", 1e3 * pose.position[0], 1e3 * pose.position[1],
           1e3 * pose.position[2], pose.margin);
    double centre[3] = {pose.position[0] - 2e-3, pose.position[1], pose.position[2]};
    tubeopt_command command = {.step = 1e-3, .speed = 0.05, .turn_rate = 6, .shift_rate = 0.1,
                               .min_margin = TUBEOPT_MIN_MARGIN, .min_snap_distance = TUBEOPT_MIN_SNAP_DISTANCE};
    for (int k = 0; k <= 2000; k++) {
        double turn = 2 * 3.14159265358979323846 * k / 2000;
        command.position[0] = centre[0] + 2e-3 * cos(turn);
        command.position[1] = centre[1] + 2e-3 * sin(turn);
        command.position[2] = centre[2];
        if (tubeopt_servo(robot, &command, &pose, &report)) return 1;
        if (k % 500 == 0)
            printf("%4d ms: %.4f mm from the circle, margin %.4f, why %d\n", k, 1e3 * report.distance, pose.margin,
                   report.why);
    }
#if TUBEOPT_BODIES
    double wall = pose.position[0] + 2e-3, radius = 1e-3, clearance = 5e-4, along[2], ends[2][3];
    command.position[0] = wall + 5e-3;
    for (int k = 0; k < 500; k++) {
        tubeopt_shape(robot, 2, along, ends); /* plate and tip */
        tubeopt_contact tip = {along[1], {-1, 0, 0}, wall - radius - ends[1][0]};
        if (tubeopt_servo_among(robot, &command, 1, &tip, clearance, &pose, &report)) return 1;
    }
    printf("the tip is %.4f mm from the wall, why %d\n", 1e3 * (wall - radius - pose.position[0]), report.why);
#endif
    free(robot);
    return 0;
}
