// Drives a TubeRobot by lines on its input; every line is answered by one. Arguments: name=value, a parameter of the
// hardware, and joint=start,least,greatest.
#include <cmath>
#include <iostream>
#include <sstream>

#include "tubeopt_hardware/tube_robot.hpp"

using namespace hardware_interface;

// Drives that can fail, and be moved by hand.
class Drives : public tubeopt_hardware::TubeRobot {
public:
    bool dead = false, moved = false;
    tubeopt_joints by_hand{};

protected:
    bool measure(tubeopt_joints &joints) override {
        TubeRobot::measure(joints);
        if (moved) joints = by_hand;
        return !dead;
    }
    bool send(const tubeopt_joints &joints) override {
        moved = false;
        return !dead && TubeRobot::send(joints);
    }
};

ComponentInfo joint_of(const std::string &name, const std::string &value) {
    std::istringstream parts(value);
    std::string start, low, high;
    std::getline(std::getline(std::getline(parts, start, ','), low, ','), high, ',');
    return {name, "joint", {{"position", low, high, ""}}, {{"position", "", "", start}}};
}

int main(int count, char **words) {
    HardwareInfo info;
    for (int k = 1; k < count; k++) {
        std::string word = words[k], name = word.substr(0, word.find('=')), value = word.substr(word.find('=') + 1);
        if (name.rfind("rotation_", 0) == 0 || name.rfind("translation_", 0) == 0)
            info.joints.push_back(joint_of(name, value));
        else
            info.hardware_parameters[name] = value;
    }
    Drives robot;
    if (robot.on_init(info) != CallbackReturn::SUCCESS) return 1;
    auto states = robot.export_state_interfaces();
    auto commands = robot.export_command_interfaces();
    for (std::string line, order; std::getline(std::cin, line);) {
        std::istringstream words(line);
        words >> order;
        int answer = 0;
        if (order == "configure") answer = (int)robot.on_configure({});
        if (order == "activate") answer = (int)robot.on_activate({});
        if (order == "deactivate") answer = (int)robot.on_deactivate({});
        if (order == "die") robot.dead = true;
        if (order == "by_hand") {
            robot.moved = true;
            for (double &x : robot.by_hand.rotations) words >> x;
            for (double &x : robot.by_hand.translations) words >> x;
        }
        if (order == "step") {
            double period;
            std::string value;
            words >> period;
            for (auto &command : commands) {
                words >> value;
                *command.value = std::stod(value);
            }
            answer = (int)robot.write({}, rclcpp::Duration(period)) + 2 * (int)robot.read({}, rclcpp::Duration(period));
        }
        std::cout << answer;
        std::cout.precision(17);
        for (auto &state : states) std::cout << ' ' << *state.value;
        std::cout << std::endl;
    }
    for (auto &state : states) std::cerr << state.name << '\n';
}
