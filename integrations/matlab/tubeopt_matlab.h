/* The C library of a robot for MATLAB's loadlibrary: numbers, and vectors of doubles alone.

   Compile tubeopt_matlab.c together with the files of `tubeopt export --c`; see README.md. One robot per library, in
   memory that the library takes at the first call. SI units: m, rad, N. A matrix goes column by column, as in MATLAB.

   joints   2n: n rotations from the inner tube outwards, then n translations from home
   pose    14: position of the tip, its 3 x 3 orientation, stability margin, elastic energy
   command 12: time step, target position, target direction (zeros leave it free), speed of the tip, turn rate, rates of
               rotations and of translations, smallest margin, and the share of the rates that raises the margin (0 to 1)
   report   3: distance from the target, angle to the target direction, and the bits of `why` in tubeopt_robot.h

   Every function that returns a status returns 0 where all went well, else a tubeopt_status of tubeopt_robot.h. */
#ifndef TUBEOPT_MATLAB_H
#define TUBEOPT_MATLAB_H

#ifdef _WIN32
#define TUBEOPT_MATLAB __declspec(dllexport)
#else
#define TUBEOPT_MATLAB
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Number of tubes n. */
TUBEOPT_MATLAB int tubeopt_matlab_tubes(void);

/* The stable equilibrium at joint values, from tubes without torsion. */
TUBEOPT_MATLAB int tubeopt_matlab_solve(const double *joints, double *pose);

/* The equilibrium after a slow straight motion from the last one; status 4 where the robot would snap. */
TUBEOPT_MATLAB int tubeopt_matlab_follow(const double *joints, double *pose);

/* Takes the last tubeopt_matlab_follow or tubeopt_matlab_servo back. */
TUBEOPT_MATLAB int tubeopt_matlab_undo(double *pose);

/* jacobian 6 x 2n: translation and turn of the tip, per rad and per m. */
TUBEOPT_MATLAB int tubeopt_matlab_jacobian(double *jacobian);

/* points 3 x count: the centreline, evenly from plate to tip. */
TUBEOPT_MATLAB int tubeopt_matlab_shape(int count, double *points);

/* One step towards a target; joints are those to send. */
TUBEOPT_MATLAB int tubeopt_matlab_servo(const double *command, double *joints, double *pose, double *report);

#ifdef __cplusplus
}
#endif
#endif
