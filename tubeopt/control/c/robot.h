/* {name}: forward kinematics, slopes, compliance, servo and snap guard, for a loop at 1 kHz.

   Made by tubeopt {version} for one robot. Needs C99 and libm; uses the vector extensions of gcc and clang. The library
   allocates no memory and has no global state: the caller gives memory for each robot and thread. Every call takes
   bounded time. SI units; tubes inner to outer; angles in rad, not wrapped; translations from home, where the curved
   part of every tube begins at the plate. */
#ifndef TUBEOPT_ROBOT_H
#define TUBEOPT_ROBOT_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TUBEOPT_TUBES {n}
#define TUBEOPT_JOINTS (2 * TUBEOPT_TUBES) /* rotations, then translations */
#define TUBEOPT_LOADS {loads}      /* 1: functions for loads are available */
#define TUBEOPT_COMPLIANCE {compliance} /* 1: the compliance of the tip is available */
#define TUBEOPT_BODIES {bodies}     /* 1: the servo avoids bodies */

#define TUBEOPT_MOST_TURN {most_turn} /* largest rotation in each direction, rad */
#define TUBEOPT_MOST_BACK {most_back} /* largest withdrawal of a tube from home, in lengths of the tube */
#define TUBEOPT_MOST_AWAY {most_back} /* largest distance of a tip target from the plate, in lengths of the longest tube */
#define TUBEOPT_MOST_NUMBER {most_number} /* limit of all other numbers, in SI units */

/* Floors for tubeopt_command.min_margin and .min_snap_distance, as exported. */
#define TUBEOPT_MIN_MARGIN {min_margin}
#define TUBEOPT_MIN_SNAP_DISTANCE {min_snap_distance} /* rad; 0: the margin counts */

typedef struct tubeopt_memory tubeopt_memory;

typedef enum {
    TUBEOPT_DONE = 0,
    TUBEOPT_DECLINED = 1,   /* no stable equilibrium was found from tubes without torsion */
    TUBEOPT_BAD_INPUT = 2,  /* a number is not finite, a translation is impossible, or the tube lengths leave the
                              carriages of a servo no range */
    TUBEOPT_NOT_STARTED = 3, /* there is no previous equilibrium */
    TUBEOPT_SNAP = 4,       /* the branch ends before the goal, or Newton's method cannot confirm that it does not */
    TUBEOPT_TOO_FAR = 5,    /* longer than the largest step: 64 parts of 0.3 rad or of 1/20 of the arm */
    TUBEOPT_TOO_LARGE = 6   /* a number is beyond the limits above: is it in SI units? */
} tubeopt_status;

typedef struct {
    double rotations[TUBEOPT_TUBES], translations[TUBEOPT_TUBES]; /* rad, m */
} tubeopt_joints;

/* Under a load, margins close to 1 are approximate, since the mesh is not refined for them. Largest errors of 373
   answers on 15 robots: 3e-4 above 0.999, 3e-5 above 0.99, and 1e-6 below. */
typedef struct {
    tubeopt_joints joints;
    double position[3];                  /* of the tip, m */
    double frame[9];                     /* rotation of the tip in the plate frame, by rows; the third column is its direction */
    double tip_rotations[TUBEOPT_TUBES]; /* of every tube at its own end, rad */
    double margin;                       /* 1: tubes do not soften each other, 0: snap; under a load see above */
    double energy;                       /* J */
    double error;                        /* estimated error of the tip, m */
    double residual;                     /* residual of the torsion equations, rad */
} tubeopt_pose;

/* Derivatives by joints, per rad and per m{how}. Where breakpoints coincide: for increasing translations. Tubes of one
   carriage have the same derivative. That of the margin is 0 at margin 1, and belongs to one of two equal modes. */
typedef struct {
    double position[3][TUBEOPT_JOINTS], turn[3][TUBEOPT_JOINTS]; /* of the tip; turn vector in the plate frame */
    double tip_rotations[TUBEOPT_TUBES][TUBEOPT_JOINTS], margin[TUBEOPT_JOINTS];
#if TUBEOPT_COMPLIANCE
    double compliance[6][6]; /* small force and moment at the tip -> its translation and turn, in the plate frame */
#endif
} tubeopt_slopes;

/* Limits of a servo step: bits of tubeopt_report.why. */
enum {
    TUBEOPT_AT_RATE = 1,    /* a joint moves at its largest rate */
    TUBEOPT_AT_RANGE = 2,   /* a joint is at the end of its range */
    TUBEOPT_AT_ORDER = 4,   /* tubes or carriages touch */
    TUBEOPT_AT_MARGIN = 8,  /* the margin is at its lower bound: the tip moves along this limit */
    TUBEOPT_SHORTENED = 16, /* the guard has shortened the step */
    TUBEOPT_HELD = 32,      /* no step is safe: the robot does not move */
    TUBEOPT_AT_BODY = 64,   /* the arm moves along a body */
    TUBEOPT_NO_CLOSER = 128, /* no small motion brings the tip closer to the target: it is out of reach from here */
    TUBEOPT_SEEKING = 256   /* a closer pose is searched, or the robot is on its way to one */
};

typedef struct {
    double step;                      /* time from the last step to this one, s */
    double position[3];               /* target of the tip, m */
    double direction[3];              /* target direction, unit vector; zeros: any direction */
    double speed;                     /* largest speed of the tip, m/s */
    double turn_rate, shift_rate;     /* largest rates of every joint, rad/s and m/s */
    double min_margin;                /* smallest allowed margin; not used where a snap distance is known and asked for */
    double push;                      /* fraction of the rates that increases the margin in the null space; 0: none */
    double turn_acceleration, shift_acceleration; /* largest accelerations of the joints, rad/s^2 and m/s^2; 0: no limit */
    double min_snap_distance;         /* turn of all tubes, rad, that must be proved to cause no snap where the robot stops;
                                         0: the margin counts. Known for up to four concentric tubes; under a load for
                                         that load, and without it */
    double velocity[3];               /* of the tip, m/s, in place of a position; zeros: the position counts */
    double closest;                   /* steps in one call of tubeopt_servo that search a closer pose, where the robot rests
                                         short of its target; 0: none. The robot then goes there, under the same guard */
} tubeopt_command;

typedef struct {
    double distance, angle; /* remaining distance, m, and angle to the target direction, rad */
    int why;                /* bits above; 0: no limit is active */
    int solves;             /* number of equilibria solved */
} tubeopt_report;

/* Size of the memory of a robot in bytes, aligned for doubles; tubeopt_start initialises it. */
size_t tubeopt_memory_size(void);
tubeopt_memory *tubeopt_start(void *memory);

/* The stable equilibrium at joint values, from tubes without torsion. Starts a new branch. */
tubeopt_status tubeopt_solve(tubeopt_memory *memory, const tubeopt_joints *joints, tubeopt_pose *pose);

/* The equilibrium after a slow straight joint motion from the last one. If it fails, the last one stays. */
tubeopt_status tubeopt_follow(tubeopt_memory *memory, const tubeopt_joints *joints, tubeopt_pose *pose);

/* Undoes the last call of tubeopt_follow or tubeopt_servo, for a motion that was not sent, for instance after a late
   step. TUBEOPT_NOT_STARTED after another call in between, and if called twice. */
tubeopt_status tubeopt_undo(tubeopt_memory *memory, tubeopt_pose *pose);

#if TUBEOPT_LOADS
/* A dead load in the plate frame: force at the tip, N, and acceleration of gravity for the tubes, m/s^2. */
typedef struct {
    double force[3], gravity[3];
} tubeopt_load;

/* The last equilibrium under a slowly applied load; zeros remove it. All further results include the load, and the arm
   must stay stable with the load and without. TUBEOPT_DECLINED or TUBEOPT_SNAP if the branch ends at a smaller load; the
   load then stays as before. */
tubeopt_status tubeopt_bear(tubeopt_memory *memory, const tubeopt_load *load, tubeopt_pose *pose);
#endif

#if TUBEOPT_LOADS
#define TUBEOPT_STATES (3 + 2 * TUBEOPT_TUBES) /* force at the tip, N; true less measured rotations, rad, and translations, m */

/* What an estimator knows without measurements: standard deviations, and correlation times, s. */
typedef struct {
    double force, rotation, translation, force_time, drift_time;
} tubeopt_prior;

/* Measurements of one time. A noise is a standard deviation per axis; where it is 0 nothing was measured. */
typedef struct {
    double time;                          /* s */
    tubeopt_joints joints;                /* measured or sent at that time */
    double position[3], position_noise;   /* of the tip, m */
    double direction[3], direction_noise; /* of the tip, of any length; rad */
    double force[3], force_noise;         /* of the load on the plate, N */
    double moment[3], moment_noise;       /* of the load about the centre of the plate, N m */
} tubeopt_reading;

typedef struct {
    double time;                          /* of the last reading, s */
    double state[TUBEOPT_STATES], covariance[TUBEOPT_STATES][TUBEOPT_STATES];
    double surprise;                      /* squared innovations of this reading over their covariance */
    int expected;                         /* expected value of it */
    int left_out;                         /* readings (tip, plate) farther off than five standard deviations */
} tubeopt_estimate;

typedef struct tubeopt_estimator tubeopt_estimator;

/* A Kalman filter for tip force and joint offsets, in memory of tubeopt_estimator_size() bytes. It has a robot of its own,
   which is solved where the robot is; tubeopt_shape of that robot is the estimated shape. */
size_t tubeopt_estimator_size(void);
tubeopt_status tubeopt_estimator_start(tubeopt_estimator *estimator, tubeopt_memory *robot, const tubeopt_prior *prior);

/* Takes in a reading, however late among the last 127 it comes: TUBEOPT_TOO_FAR beyond. TUBEOPT_SNAP where the branch of the
   model ends; the estimate then stays. */
tubeopt_status tubeopt_measure(tubeopt_estimator *estimator, tubeopt_memory *robot, const tubeopt_reading *reading,
                               tubeopt_estimate *estimate);

/* The estimate at a time after the last reading. */
tubeopt_status tubeopt_estimate_at(const tubeopt_estimator *estimator, double time, tubeopt_estimate *estimate);
#endif

/* Derivatives at the last equilibrium. */
tubeopt_status tubeopt_slopes_at(tubeopt_memory *memory, tubeopt_slopes *slopes);

/* Turn of all tubes, rad, each either way and in any order, that is proved to cause no snap at the last equilibrium. At most
   `most`, or INFINITY where no turn can snap; -1 where it is not known: off the centreline, of five tubes. Under a load it holds
   for that load and without it, and is at most pi. Whether it is `most` takes 0.1 ms, under a load 1 to 8 ms. A smaller one takes
   1 ms, under a load 6 to 120 ms. */
double tubeopt_snap_distance(tubeopt_memory *memory, double most);

/* Time, s, at most `most`, within which it is proved that nothing snaps while each joint moves either way, at up to these rates
   (rad/s, m/s). Whether it is `most` takes 1 to 8 ms, a shorter time ten times as long. -1 where it is not known: as above, under a
   load, and of tubes made of pieces. */
double tubeopt_snap_time(tubeopt_memory *memory, double turn_rate, double shift_rate, double most);

/* `count` equally spaced points of the centreline from plate to tip: arc lengths (m) and positions. */
tubeopt_status tubeopt_shape(const tubeopt_memory *memory, int count, double *arc_length, double (*position)[3]);

/* One step towards a command, from the last equilibrium. Send the joint values pose->joints. The step keeps rates,
   ranges, order and the smallest margin. Its equilibrium is solved on the branch before it is returned. */
tubeopt_status tubeopt_servo(tubeopt_memory *memory, const tubeopt_command *command, tubeopt_pose *pose,
                             tubeopt_report *report);

/* One step straight to joint values; TUBEOPT_BAD_INPUT outside of ranges and order. Of the command only step, rates,
   accelerations, margin and snap distance are used. */
tubeopt_status tubeopt_servo_joints(tubeopt_memory *memory, const tubeopt_command *command, const tubeopt_joints *goal,
                                    tubeopt_pose *pose, tubeopt_report *report);

#if TUBEOPT_BODIES
#define TUBEOPT_MOST_CONTACTS 32

/* A point of the arm close to a body: its arc length (m), the unit vector from the body to it, and the distance of the
   surface of the arm from the body (m). */
typedef struct {
    double arc_length, normal[3], distance;
} tubeopt_contact;

/* As tubeopt_servo, for an arm without load. The points of `count` contacts stay on their side of the planes normal to
   their vectors, `clearance` (m) from the bodies, or come no closer. Before every step the caller finds the closest
   points (tubeopt_shape returns the centreline). If the arm comes too close elsewhere, undo the step by tubeopt_undo.
   A command with `closest` is TUBEOPT_BAD_INPUT: the search would need contacts at poses where the arm is not. */
tubeopt_status tubeopt_servo_among(tubeopt_memory *memory, const tubeopt_command *command, int count,
                                   const tubeopt_contact *contacts, double clearance, tubeopt_pose *pose,
                                   tubeopt_report *report);
#endif

#ifdef __cplusplus
}
#endif
#endif
