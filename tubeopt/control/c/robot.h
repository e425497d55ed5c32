/* {name}: forward kinematics, slopes, compliance, servo and snap guard, for a loop at 1 kHz.

   Made by tubeopt {version} from the numbers of the robot. C99 and libm; gcc or clang, whose vectors it uses. Nothing is
   allocated and nothing is global: all state is in the memory that the caller gives, one piece per robot and thread.
   Every call takes bounded time. SI units; tubes from the inner one outwards; angles in rad, not wrapped; translations
   from home, where every tube's transition from straight to curved lies at the plate. */
#ifndef TUBEOPT_ROBOT_H
#define TUBEOPT_ROBOT_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TUBEOPT_TUBES {n}
#define TUBEOPT_JOINTS (2 * TUBEOPT_TUBES) /* rotations, then translations */
#define TUBEOPT_LOADS {loads}      /* whether the robot can bear loads */
#define TUBEOPT_COMPLIANCE {compliance} /* whether the compliance of the tip is known */
#define TUBEOPT_BODIES {bodies}     /* whether the servo keeps clear of bodies */

#define TUBEOPT_MOST_TURN {most_turn} /* rad, of a rotation to either side */
#define TUBEOPT_MOST_BACK {most_back} /* lengths of itself by which a tube may be drawn back from home */
#define TUBEOPT_MOST_AWAY {most_back} /* lengths of the longest tube by which a place for the tip may be away from the plate */
#define TUBEOPT_MOST_NUMBER {most_number} /* of every other number, in SI units */

typedef struct tubeopt_memory tubeopt_memory;

typedef enum {
    TUBEOPT_DONE = 0,
    TUBEOPT_DECLINED = 1,   /* no stable equilibrium was found from tubes without torsion */
    TUBEOPT_BAD_INPUT = 2,  /* a number is not finite, a translation is not possible, or a servo has carriages apart
                              that the lengths of the tubes leave no play */
    TUBEOPT_NOT_STARTED = 3, /* there is no equilibrium to go on from */
    TUBEOPT_SNAP = 4,       /* the branch does not lead there, or Newton's method is not sure that it does */
    TUBEOPT_TOO_FAR = 5,    /* more than one step may be: 64 of 0.3 rad or of a twentieth of the arm */
    TUBEOPT_TOO_LARGE = 6   /* a number is finite, but beyond the limits below: is it in SI units? */
} tubeopt_status;

typedef struct {
    double rotations[TUBEOPT_TUBES], translations[TUBEOPT_TUBES]; /* rad, m */
} tubeopt_joints;

/* Under a load, margins close to 1 are rough, since the mesh is not refined for them: of 373 answers on 15 robots the
   worst was 3e-4 too large above 0.999, 3e-5 above 0.99, and 1e-6 off below. */
typedef struct {
    tubeopt_joints joints;
    double position[3];                  /* of the tip, m */
    double frame[9];                     /* of the tip in that of the plate, by rows; its third column points ahead */
    double tip_rotations[TUBEOPT_TUBES]; /* of every tube at its own end, rad */
    double margin;                       /* 1: coupling softens nothing, 0: a snap; see above under a load */
    double energy;                       /* J */
    double error;                        /* estimate, of the tip, m */
    double residual;                     /* of the equations of torsion, rad */
} tubeopt_pose;

/* Derivatives by joints, per rad and per m{how}. Where breakpoints coincide, those of translations that grow. Tubes of
   one carriage share the derivative. The margin's is 0 where that is 1, and of one mode where two have the same margin. */
typedef struct {
    double position[3][TUBEOPT_JOINTS], turn[3][TUBEOPT_JOINTS]; /* of the tip; turn vector in the plate frame */
    double tip_rotations[TUBEOPT_TUBES][TUBEOPT_JOINTS], margin[TUBEOPT_JOINTS];
#if TUBEOPT_COMPLIANCE
    double compliance[6][6]; /* small force and moment at the tip -> its translation and turn, in the plate frame */
#endif
} tubeopt_slopes;

/* Why a servo step is not all that was asked for: bits of tubeopt_report.why. */
enum {
    TUBEOPT_AT_RATE = 1,    /* a joint moves as fast as it may */
    TUBEOPT_AT_RANGE = 2,   /* a joint is at the end of its range */
    TUBEOPT_AT_ORDER = 4,   /* tubes or carriages touch */
    TUBEOPT_AT_MARGIN = 8,  /* the margin is held at its floor: the tip slides along it */
    TUBEOPT_SHORTENED = 16, /* the guard has shortened the step */
    TUBEOPT_HELD = 32,      /* no step is safe: the robot stays where it is */
    TUBEOPT_AT_BODY = 64    /* the arm slides along a body */
};

typedef struct {
    double step;                      /* time from the last step to this one, s */
    double position[3];               /* where the tip shall go, m */
    double direction[3];              /* unit vector along which it shall point; zeros: anywhere */
    double speed;                     /* most that the tip is asked to move, m/s */
    double turn_rate, shift_rate;     /* most of every joint, rad/s and m/s */
    double min_margin;                /* floor of the margin */
    double push;                      /* share of the rates that goes towards larger margin where the tip is free; 0: none */
} tubeopt_command;

typedef struct {
    double distance, angle; /* from the tip to where it shall be, m, and from its direction to the wanted one, rad */
    int why;                /* bits above; 0: nothing is in the way */
    int solves;             /* equilibria that the step cost */
} tubeopt_report;

/* Bytes of memory that a robot needs, aligned for doubles; tubeopt_start makes it ready. */
size_t tubeopt_memory_size(void);
tubeopt_memory *tubeopt_start(void *memory);

/* The stable equilibrium at joint values, from tubes without torsion. The branch starts anew. */
tubeopt_status tubeopt_solve(tubeopt_memory *memory, const tubeopt_joints *joints, tubeopt_pose *pose);

/* The equilibrium to which a slow straight motion from the last one leads. The last one stays where it fails. */
tubeopt_status tubeopt_follow(tubeopt_memory *memory, const tubeopt_joints *joints, tubeopt_pose *pose);

/* Takes the last call of tubeopt_follow or tubeopt_servo back, for a motion that was not sent, as when time ran out:
   the robot is where it was before. TUBEOPT_NOT_STARTED where another call has come in between, and the second time. */
tubeopt_status tubeopt_undo(tubeopt_memory *memory, tubeopt_pose *pose);

#if TUBEOPT_LOADS
/* A dead load, in the plate frame: a force at the tip, N, and the acceleration by which the tubes weigh, m/s^2. */
typedef struct {
    double force[3], gravity[3];
} tubeopt_load;

/* The last equilibrium under a load, which is put on slowly; zeros take it off. From here on all that is told is of the
   loaded arm, and it must stay stable with the load and without. TUBEOPT_DECLINED or TUBEOPT_SNAP where the branch ends
   before the load is on: the load is then what it was. */
tubeopt_status tubeopt_bear(tubeopt_memory *memory, const tubeopt_load *load, tubeopt_pose *pose);
#endif

/* Derivatives at the last equilibrium. */
tubeopt_status tubeopt_slopes_at(tubeopt_memory *memory, tubeopt_slopes *slopes);

/* `count` points of the centreline, evenly from plate to tip: arc lengths (m) and positions. */
tubeopt_status tubeopt_shape(const tubeopt_memory *memory, int count, double *arc_length, double (*position)[3]);

/* One step towards a command, from the last equilibrium: joint values to send are pose->joints. It keeps rates, ranges,
   order and the floor of the margin, and its equilibrium was solved for, on the branch, before it is given out. */
tubeopt_status tubeopt_servo(tubeopt_memory *memory, const tubeopt_command *command, tubeopt_pose *pose,
                             tubeopt_report *report);

#if TUBEOPT_BODIES
#define TUBEOPT_MOST_CONTACTS 32

/* Where the arm comes close to a body: the arc length of the place, the unit vector from the body towards it, and how
   far the surface of the arm is from the body there; m. */
typedef struct {
    double arc_length, normal[3], distance;
} tubeopt_contact;

/* As tubeopt_servo, of an arm without load: the places of `count` contacts stay on their side of the planes square to
   their normals, `clearance` (m) away from the bodies, or no closer than they are. What bodies there are, and where the
   arm is closest to them (tubeopt_shape tells its centreline), is for the caller to find before every step; who finds
   that the arm has come too close elsewhere takes the step back by tubeopt_undo. */
tubeopt_status tubeopt_servo_among(tubeopt_memory *memory, const tubeopt_command *command, int count,
                                   const tubeopt_contact *contacts, double clearance, tubeopt_pose *pose,
                                   tubeopt_report *report);
#endif

#ifdef __cplusplus
}
#endif
#endif
