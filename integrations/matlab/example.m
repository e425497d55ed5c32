% Equilibrium, Jacobian, shape and servo of the three-tube robot of the thesis in MATLAB.
%
% First build the library, see README.md. Then run this file in its folder.
[here, ~, ~] = fileparts(mfilename('fullpath'));
addpath(fullfile(here, 'build'));
if ~libisloaded('tubeopt_matlab')
    name = 'tubeopt_matlab';
    if ~ispc
        name = 'libtubeopt_matlab';
    end
    loadlibrary(name, fullfile(here, 'tubeopt_matlab.h'), 'alias', 'tubeopt_matlab');
end

n = calllib('tubeopt_matlab', 'tubeopt_matlab_tubes');
joints = [0; 1; 2; -0.05; -0.03; -0.02];          % rad, then m

pose = libpointer('doublePtr', zeros(14, 1));
status = calllib('tubeopt_matlab', 'tubeopt_matlab_solve', joints, pose);
assert(status == 0, 'no stable equilibrium was found: status %d', status);
fprintf('tip (mm): %.4f %.4f %.4f, margin %.4f\n', 1e3 * pose.Value(1:3), pose.Value(13));

jacobian = libpointer('doublePtr', zeros(6, 2 * n));
calllib('tubeopt_matlab', 'tubeopt_matlab_jacobian', jacobian);
fprintf('mm per rad of the inner tube: %.4f %.4f %.4f\n', 1e3 * jacobian.Value(1:3, 1));

points = libpointer('doublePtr', zeros(3, 100));
calllib('tubeopt_matlab', 'tubeopt_matlab_shape', 100, points);
plot3(1e3 * points.Value(1, :), 1e3 * points.Value(2, :), 1e3 * points.Value(3, :), 'LineWidth', 2);
axis equal; grid on; xlabel('x (mm)'); ylabel('y (mm)'); zlabel('z (mm)');

% The tip moves 2 mm along -x in steps of 1 ms, at 20 mm/s at most, with a margin of at least 0.1.
target = pose.Value(1:3) - [2e-3; 0; 0];
command = [1e-3; target; 0; 0; 0; 0.02; 6; 0.1; 0.1; 0];
report = libpointer('doublePtr', zeros(3, 1));
send = libpointer('doublePtr', joints);
for k = 1:200
    status = calllib('tubeopt_matlab', 'tubeopt_matlab_servo', command, send, pose, report);
    assert(status == 0, 'the servo failed: status %d', status);
end
fprintf('%.6f mm from the target, margin %.4f\n', 1e3 * report.Value(1), pose.Value(13));

clear pose jacobian points report send
unloadlibrary('tubeopt_matlab');

% Tables of tubeopt: tubeopt follow ROBOT.yaml PATH.csv --format mat --out results
%   path = load('results/path.mat');  plot(path.rotation_1_deg, path.margin)
