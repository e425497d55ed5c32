// The joints of a tube robot for ros2_control: positions of controllers pass through the servo of the C library, which
// keeps rates, ranges, order and the smallest stability margin, before they reach the drives.
#ifndef TUBEOPT_HARDWARE__TUBE_ROBOT_HPP_
#define TUBEOPT_HARDWARE__TUBE_ROBOT_HPP_

#include <array>
#include <string>
#include <vector>

#include "hardware_interface/system_interface.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "tubeopt_robot.h"

namespace tubeopt_hardware {

using hardware_interface::CallbackReturn;
using hardware_interface::return_type;

class TubeRobot : public hardware_interface::SystemInterface {
public:
    CallbackReturn on_init(const hardware_interface::HardwareInfo &info) override;
    std::vector<hardware_interface::StateInterface> export_state_interfaces() override;
    std::vector<hardware_interface::CommandInterface> export_command_interfaces() override;
    CallbackReturn on_configure(const rclcpp_lifecycle::State &) override;
    CallbackReturn on_activate(const rclcpp_lifecycle::State &) override;
    CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override;
    return_type read(const rclcpp::Time &, const rclcpp::Duration &period) override;
    return_type write(const rclcpp::Time &, const rclcpp::Duration &period) override;

protected:
    // Joint values of the drives. Here they are where they were sent: derive a class for your drives, override both,
    // and name it in the URDF. False: the drives do not answer, which is an error.
    virtual bool measure(tubeopt_joints &joints);
    virtual bool send(const tubeopt_joints &joints);

private:
    tubeopt_memory *robot() { return reinterpret_cast<tubeopt_memory *>(memory_.data()); }
    bool follow_drives();  // the equilibrium of the measured joint values
    bool parameter(const std::string &name, double &value) const;
    bool read_order();
    bool allowed(const std::array<double, TUBEOPT_JOINTS> &joints) const;  // within ranges and order
    void show();

    std::vector<double> memory_;
    tubeopt_command limits_{};  // of a step; its period is filled in each time
    tubeopt_pose pose_{};       // last equilibrium that was sent
    tubeopt_joints sent_{};     // what the drives of this class are at
    bool solved_ = false;
    // translation `ahead` - translation `behind` >= least, tubes from 0: the order of carriages and of ends.
    struct Order {
        int ahead, behind;
        double least;
    };
    std::vector<Order> order_;
    std::array<double, TUBEOPT_JOINTS> low_{}, high_{};
    // In the order rotation_1, ..., translation_1, ....
    std::array<double, TUBEOPT_JOINTS> command_{}, position_{}, velocity_{};
    double margin_ = 0, why_ = 0, tip_[3] = {0, 0, 0};
};

}  // namespace tubeopt_hardware
#endif
