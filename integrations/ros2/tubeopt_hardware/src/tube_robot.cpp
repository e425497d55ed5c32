#include "tubeopt_hardware/tube_robot.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "hardware_interface/types/hardware_interface_type_values.hpp"
#include "pluginlib/class_list_macros.hpp"

namespace tubeopt_hardware {
namespace {

constexpr int N = TUBEOPT_TUBES;

// After a stall of the controller manager the joints move as in a step of this length, s, and catch up later.
constexpr double LONGEST_STEP = 0.02;

// Round-off of commands at the end of a range, rad or m.
constexpr double ROUND_OFF = 1e-9;

// Drives that have moved farther than this, rad or m, since the last step are followed when they are activated.
constexpr double MOVED = 1e-9;

rclcpp::Logger logger() { return rclcpp::get_logger("TubeRobot"); }

std::string name_of(int joint) {
    return (joint < N ? "rotation_" : "translation_") + std::to_string(joint % N + 1);
}

std::array<double, TUBEOPT_JOINTS> values_of(const tubeopt_joints &joints) {
    std::array<double, TUBEOPT_JOINTS> all;
    std::copy(joints.rotations, joints.rotations + N, all.begin());
    std::copy(joints.translations, joints.translations + N, all.begin() + N);
    return all;
}

bool number(const std::string &text, double &value) {
    char *end = nullptr;
    value = std::strtod(text.c_str(), &end);
    return !text.empty() && *end == '\0' && std::isfinite(value);
}

}  // namespace

CallbackReturn TubeRobot::on_init(const hardware_interface::HardwareInfo &info) {
    if (hardware_interface::SystemInterface::on_init(info) != CallbackReturn::SUCCESS) return CallbackReturn::ERROR;
    double start[TUBEOPT_JOINTS];
    for (int k = 0; k < TUBEOPT_JOINTS; k++) {
        auto joint = std::find_if(info.joints.begin(), info.joints.end(),
                                  [k](const auto &one) { return one.name == name_of(k); });
        if (joint == info.joints.end() || info.joints.size() != TUBEOPT_JOINTS) {
            RCLCPP_ERROR(logger(), "the URDF has %zu joints; it must have %d, with %s among them", info.joints.size(),
                         TUBEOPT_JOINTS, name_of(k).c_str());
            return CallbackReturn::ERROR;
        }
        start[k] = 0;
        for (const auto &state : joint->state_interfaces)
            if (state.name == hardware_interface::HW_IF_POSITION && !state.initial_value.empty() &&
                !number(state.initial_value, start[k])) {
                RCLCPP_ERROR(logger(), "initial_value of %s is '%s'; it must be a number", joint->name.c_str(),
                             state.initial_value.c_str());
                return CallbackReturn::ERROR;
            }
        const auto &commands = joint->command_interfaces;
        if (commands.size() != 1 || !number(commands[0].min, low_[k]) || !number(commands[0].max, high_[k])) {
            RCLCPP_ERROR(logger(), "%s must have one command interface, position, with min and max",
                         joint->name.c_str());
            return CallbackReturn::ERROR;
        }
    }
    std::copy(start, start + N, sent_.rotations);
    std::copy(start + N, start + TUBEOPT_JOINTS, sent_.translations);
    const bool given = parameter("turn_rate", limits_.turn_rate) && parameter("shift_rate", limits_.shift_rate) &&
                       parameter("turn_acceleration", limits_.turn_acceleration) &&
                       parameter("shift_acceleration", limits_.shift_acceleration) &&
                       parameter("min_margin", limits_.min_margin) &&
                       parameter("min_snap_distance", limits_.min_snap_distance);
    limits_.speed = limits_.shift_rate;  // of the tip: not used by a step to joint values
    memory_.assign(tubeopt_memory_size() / sizeof(double) + 1, 0.0);
    tubeopt_start(memory_.data());
    return given && read_order() ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
}

bool TubeRobot::parameter(const std::string &name, double &value) const {
    const auto found = info_.hardware_parameters.find(name);
    if (found != info_.hardware_parameters.end() && number(found->second, value) && value >= 0) return true;
    RCLCPP_ERROR(logger(), "the hardware has no parameter %s that is a number of at least 0", name.c_str());
    return false;
}

bool TubeRobot::read_order() {
    const auto found = info_.hardware_parameters.find("order");
    std::istringstream words(found == info_.hardware_parameters.end() ? "none" : found->second);
    std::vector<double> all;
    for (double next; words >> next;) all.push_back(next);
    bool known = words.eof() && all.size() % 3 == 0;
    order_.clear();
    for (size_t k = 0; known && k < all.size(); k += 3) {
        known = std::min(all[k], all[k + 1]) >= 1 && std::max(all[k], all[k + 1]) <= N;
        order_.push_back({int(all[k]) - 1, int(all[k + 1]) - 1, all[k + 2]});
    }
    if (known) return true;
    RCLCPP_ERROR(logger(), "the parameter order must have triples: tube ahead, tube behind, least distance (m)");
    return false;
}

bool TubeRobot::allowed(const std::array<double, TUBEOPT_JOINTS> &joints) const {
    for (int k = 0; k < TUBEOPT_JOINTS; k++)
        if (joints[k] < low_[k] - ROUND_OFF || joints[k] > high_[k] + ROUND_OFF) return false;
    for (const auto &one : order_)
        if (joints[N + one.ahead] - joints[N + one.behind] < one.least - ROUND_OFF) return false;
    return true;
}

std::vector<hardware_interface::StateInterface> TubeRobot::export_state_interfaces() {
    std::vector<hardware_interface::StateInterface> all;
    for (int k = 0; k < TUBEOPT_JOINTS; k++) {
        all.emplace_back(name_of(k), hardware_interface::HW_IF_POSITION, &position_[k]);
        all.emplace_back(name_of(k), hardware_interface::HW_IF_VELOCITY, &velocity_[k]);
    }
    all.emplace_back("arm", "margin", &margin_);
    all.emplace_back("arm", "why", &why_);
    const char *axes[] = {"tip.x", "tip.y", "tip.z"};
    for (int r = 0; r < 3; r++) all.emplace_back("arm", axes[r], &tip_[r]);
    return all;
}

std::vector<hardware_interface::CommandInterface> TubeRobot::export_command_interfaces() {
    std::vector<hardware_interface::CommandInterface> all;
    for (int k = 0; k < TUBEOPT_JOINTS; k++)
        all.emplace_back(name_of(k), hardware_interface::HW_IF_POSITION, &command_[k]);
    return all;
}

bool TubeRobot::follow_drives() {
    tubeopt_joints at;
    if (!measure(at)) {
        RCLCPP_ERROR(logger(), "the drives do not answer");
        return false;
    }
    const auto now = values_of(at), before = values_of(pose_.joints);
    double moved = 0;
    for (int k = 0; k < TUBEOPT_JOINTS; k++) moved = std::max(moved, std::fabs(now[k] - before[k]));
    // Without an equilibrium before, the tubes are taken to be without torsion beforehand.
    tubeopt_status status = TUBEOPT_DONE;
    if (!solved_) status = tubeopt_solve(robot(), &at, &pose_);
    else if (moved > MOVED) status = tubeopt_follow(robot(), &at, &pose_);
    if (status != TUBEOPT_DONE) {
        RCLCPP_ERROR(logger(), "no stable equilibrium at the joint values of the drives: status %d", status);
        return false;
    }
    solved_ = true;
    position_ = command_ = now;
    velocity_.fill(0.0);
    show();
    return true;
}

CallbackReturn TubeRobot::on_configure(const rclcpp_lifecycle::State &) {
    solved_ = false;
    return follow_drives() ? CallbackReturn::SUCCESS : CallbackReturn::FAILURE;
}

CallbackReturn TubeRobot::on_activate(const rclcpp_lifecycle::State &) {
    return follow_drives() ? CallbackReturn::SUCCESS : CallbackReturn::FAILURE;
}

CallbackReturn TubeRobot::on_deactivate(const rclcpp_lifecycle::State &) {
    command_ = values_of(pose_.joints);
    return CallbackReturn::SUCCESS;
}

return_type TubeRobot::read(const rclcpp::Time &, const rclcpp::Duration &period) {
    tubeopt_joints at;
    if (!measure(at)) return return_type::ERROR;
    const auto now = values_of(at);
    if (period.seconds() > 0)
        for (int k = 0; k < TUBEOPT_JOINTS; k++) velocity_[k] = (now[k] - position_[k]) / period.seconds();
    position_ = now;
    return return_type::OK;
}

return_type TubeRobot::write(const rclcpp::Time &, const rclcpp::Duration &period) {
    if (!(period.seconds() > 0)) return return_type::OK;
    // A controller that has not started yet commands NaN: its joint stays where it was sent.
    auto goal = values_of(pose_.joints);
    for (int k = 0; k < TUBEOPT_JOINTS; k++)
        if (std::isfinite(command_[k])) goal[k] = command_[k];
    tubeopt_joints to;
    std::copy(goal.begin(), goal.begin() + N, to.rotations);
    std::copy(goal.begin() + N, goal.end(), to.translations);
    tubeopt_command command = limits_;
    command.step = std::min(period.seconds(), LONGEST_STEP);
    tubeopt_pose next;
    tubeopt_report report;
    // The library steps straight to what it is given: ranges and order are checked here.
    tubeopt_status status =
        allowed(goal) ? tubeopt_servo_joints(robot(), &command, &to, &next, &report) : TUBEOPT_BAD_INPUT;
    const bool refused = status != TUBEOPT_DONE;
    if (refused) {  // the joints brake and stay
        command.speed = 0;
        std::copy(pose_.position, pose_.position + 3, command.position);
        status = tubeopt_servo(robot(), &command, &next, &report);
    }
    if (status != TUBEOPT_DONE) {
        why_ = TUBEOPT_HELD;
        return return_type::OK;
    }
    if (!send(next.joints)) {
        tubeopt_undo(robot(), &next);
        RCLCPP_ERROR(logger(), "the drives do not take a command");
        return return_type::ERROR;
    }
    pose_ = next;
    why_ = report.why | (refused ? TUBEOPT_HELD : 0);
    show();
    return return_type::OK;
}

void TubeRobot::show() {
    margin_ = pose_.margin;
    std::copy(pose_.position, pose_.position + 3, tip_);
}

bool TubeRobot::measure(tubeopt_joints &joints) {
    joints = sent_;
    return true;
}

bool TubeRobot::send(const tubeopt_joints &joints) {
    sent_ = joints;
    return true;
}

}  // namespace tubeopt_hardware

PLUGINLIB_EXPORT_CLASS(tubeopt_hardware::TubeRobot, hardware_interface::SystemInterface)
