// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Regressors of the physical model: the wrench of each of its terms, per unit of its parameter.
//
// Rotor i at r_i with spin s_i and speed ω sees V + Ω × r_i = (u, v, w), with h = √(u² + v²) in its plane and
// its own induced velocity; models/physical_terms.py says what each term means and where it comes from.
#pragma once

#include "quadpi/inputs.hpp"
#include "quadpi/records.hpp"
#include "quadpi/signals/wrench.hpp"

namespace quadpi {

// Below this a rotor stands still for terms that divide by its speed [rad/s]; hover is at 350 rad/s or more
// on all vehicles of config/vehicles.
constexpr double SLOWEST_RAD_S = 50.0;

// What the regressors of a sample follow from, body axes.
struct MotionSample {
    Vector3 velocity;              // m/s relative to the air
    Vector3 rates;                 // rad/s
    Vector3 angular_acceleration;  // rad/s²
    PerRotor rotor_speeds;         // rad/s
    PerRotor rotor_accelerations;  // rad/s²
};

// The numbers of a vehicle that the regressors need.
struct PhysicalVehicle {
    double mass;              // kg
    double reference_thrust;  // N s², of a rotor per ω², for the induced velocity
    double disc;              // kg/m, 2 ρ π R² of momentum theory
    std::int64_t rotors;
    std::array<Vector3, ROTORS_MAX> positions;  // m
    PerRotor spins;                             // +1 where a rotor turns clockwise seen from above
};

// Regressors of one sample by the name of their parameter, in the order of TERMS of physical_terms.py.
struct Regressors {
    // Thrust, and differences of rotors.
    Wrench thrust, thrust_axial, thrust_induced, thrust_axial_square, thrust_in_plane, thrust_advance;
    Wrench thrust_axial_in_plane, thrust_axial_induced, thrust_axial_even, thrust_in_plane_cubed;
    Wrench thrust_mixed_cubed, thrust_incline_x, thrust_incline_y;
    Wrench thrust_rotor_1, thrust_rotor_2, thrust_rotor_3;
    // Moments of thrust alone, and what rotors do to each other.
    Wrench arm_thrust, arm_x, arm_axial, arm_induced, arm_in_plane, arm_advance, arm_axial_in_plane;
    Wrench wake_x, wake_y, wake_axial_x, wake_axial_y, thrust_forward, thrust_sideways;
    Wrench wake_moment_x, wake_moment_y;
    // Torque.
    Wrench torque, torque_axial, torque_induced, torque_advance;
    Wrench torque_rotor_1, torque_rotor_2, torque_rotor_3;
    // Forces in the plane and moments of the hubs.
    Wrench rotor_drag, rotor_drag_advance, rotor_drag_axial, rotor_drag_induced;
    Wrench rotor_side, rotor_side_advance, rotor_side_axial, rotor_side_induced;
    Wrench hub_height, hub_height_advance, hub_height_induced, hub_roll, hub_roll_induced;
    // The airframe.
    Wrench body_x_speed, body_y_speed, body_x_induced, body_y_induced, body_x_cross, body_y_cross;
    Wrench body_x_downwash, body_y_downwash, body_roll_downwash, body_pitch_downwash;
    Wrench drag_x, drag_y, drag_z, drag_x_speed, drag_y_speed, drag_z_speed;
    Wrench lift_w_u, lift_w_v, lift_x, lift_y, pitch_u, pitch_uw, roll_v, roll_vw, yaw_uv, yaw_v;
    Wrench damping_p, damping_q, damping_r;
    // Inertia, what remains at rest, and the accelerometer.
    Wrench rotor_inertia_gyro, rotor_inertia_spin, inertia_x, inertia_y, inertia_z;
    Wrench bias_x, bias_y, bias_z, bias_roll, bias_pitch, bias_yaw;
    Wrench incline_x, incline_y, gravity_centre_x, gravity_centre_y;
    Wrench imu_x, imu_y, imu_z;
};

constexpr std::size_t TERMS = sizeof(Regressors) / sizeof(Wrench);
using TermValues = std::array<double, TERMS>;

// The regressors one after another.
inline const Wrench* terms_of(const Regressors& row) { return reinterpret_cast<const Wrench*>(&row); }

// Wrench of regressors, for a parameter of each term.
inline Wrench wrench_of(const Regressors& row, const TermValues& parameters) {
    Wrench wrench{};
    for (std::size_t term = 0; term < TERMS; ++term) {
        for (int axis = 0; axis < AXES; ++axis) {
            wrench[axis] += parameters[term] * terms_of(row)[term][axis];
        }
    }
    return wrench;
}

// Scale the wrench that the air gives: at the same velocities and rotor speeds it goes with the density.
//
// What is left is inertia, the rotors' too, and what the sensors have of their own.
inline void scale_by_density(Regressors& row, double ratio) {
    Wrench* terms = reinterpret_cast<Wrench*>(&row);
    constexpr std::size_t parts[][2] = {
        {0, offsetof(Regressors, rotor_inertia_gyro) / sizeof(Wrench)},
        {offsetof(Regressors, incline_x) / sizeof(Wrench), offsetof(Regressors, imu_x) / sizeof(Wrench)},
    };
    for (const auto& [first, end] : parts) {
        for (std::size_t term = first; term < end; ++term) {
            for (double& value : terms[term]) {
                value *= ratio;
            }
        }
    }
}

// A rotor, and the air there.
struct Hub {
    double x, y;     // m
    double spin;     // +1 clockwise
    double speed;    // rad/s
    double u, v, w;  // m/s relative to the air
    double in_plane;
    double induced;  // m/s, induced velocity
    double turning;  // rad/s, the speed that terms may divide by
};

// Add the moments alone of a force along -z at a hub.
inline void add_arm(Wrench& term, const Hub& hub, double thrust) {
    term[3] -= hub.y * thrust;
    term[4] += hub.x * thrust;
}

// Add a force along -z at a hub.
inline void add_thrust(Wrench& term, const Hub& hub, double thrust) {
    term[2] -= thrust;
    add_arm(term, hub, thrust);
}

// Add a force in the rotor plane at a hub, with its moment about z.
inline void add_in_plane(Wrench& term, const Hub& hub, double force_x, double force_y) {
    term[0] += force_x;
    term[1] += force_y;
    term[5] += hub.x * force_y - hub.y * force_x;
}

inline void add_moments(Wrench& term, double roll, double pitch) {
    term[3] += roll;
    term[4] += pitch;
}

inline Hub hub_of(int rotor, const MotionSample& motion, const PhysicalVehicle& vehicle) {
    const auto [p, q, r] = motion.rates;
    const auto [x, y, z] = vehicle.positions[rotor];
    const double speed = motion.rotor_speeds[rotor];
    const double u = motion.velocity[0] + q * z - r * y;
    const double v = motion.velocity[1] + r * x - p * z;
    const double w = motion.velocity[2] + p * y - q * x;
    const double in_plane = std::sqrt(u * u + v * v), turning = std::max(speed, SLOWEST_RAD_S);
    const double hover = turning * std::sqrt(vehicle.reference_thrust / vehicle.disc);
    const double induced = solve_induced_velocity(in_plane, w, hover);
    return {x, y, vehicle.spins[rotor], speed, u, v, w, in_plane, induced, turning};
}

// Add what rotors have more than the last: thrust by ω² and torque by s ω². Of more than four rotors, the
// first three.
inline void add_unlike(int rotor, int rotors, const Hub& hub, Regressors& row) {
    Wrench* const thrusts[] = {&row.thrust_rotor_1, &row.thrust_rotor_2, &row.thrust_rotor_3};
    Wrench* const torques[] = {&row.torque_rotor_1, &row.torque_rotor_2, &row.torque_rotor_3};
    const double square = hub.speed * hub.speed, torque = hub.spin * square;
    for (int other = 0; other < std::min(rotors - 1, 3); ++other) {
        if (rotor == other) {
            add_thrust(*thrusts[other], hub, square);
            (*torques[other])[5] -= torque;
        } else if (rotor == rotors - 1) {
            add_thrust(*thrusts[other], hub, -square);
            (*torques[other])[5] += torque;
        }
    }
}

// Add thrust, and the moments that it gives.
inline void add_thrusts(const Hub& hub, Regressors& row) {
    const double speed = hub.speed, square = speed * speed, induced = hub.induced, turning = hub.turning;
    const double u = hub.u, v = hub.v, w = hub.w, h = hub.in_plane;
    const double front = sign_of(hub.x), right = sign_of(hub.y);
    add_thrust(row.thrust, hub, square);
    add_thrust(row.thrust_axial, hub, speed * w);
    add_thrust(row.thrust_induced, hub, -speed * induced);
    add_thrust(row.thrust_axial_square, hub, w * std::abs(w));
    add_thrust(row.thrust_in_plane, hub, h * h);
    add_thrust(row.thrust_advance, hub, speed * h);
    add_thrust(row.thrust_axial_in_plane, hub, w * h);
    add_thrust(row.thrust_axial_induced, hub, w * induced);
    add_thrust(row.thrust_axial_even, hub, w * w);
    add_thrust(row.thrust_in_plane_cubed, hub, h * h * h / turning);
    add_thrust(row.thrust_mixed_cubed, hub, h * w * w / turning);
    add_thrust(row.thrust_incline_x, hub, speed * u);
    add_thrust(row.thrust_incline_y, hub, speed * v);

    add_arm(row.arm_thrust, hub, square);
    row.arm_x[4] += hub.x * square;
    add_arm(row.arm_axial, hub, speed * w);
    add_arm(row.arm_induced, hub, -speed * induced);
    add_arm(row.arm_in_plane, hub, h * h);
    add_arm(row.arm_advance, hub, speed * h);
    add_arm(row.arm_axial_in_plane, hub, w * h);
    row.wake_x[2] -= front * speed * u;
    row.wake_y[2] -= right * speed * v;
    row.wake_axial_x[2] -= front * w * u;
    row.wake_axial_y[2] -= right * w * v;
    row.thrust_forward[2] -= speed * std::abs(u);
    row.thrust_sideways[2] -= speed * std::abs(v);
    add_arm(row.wake_moment_x, hub, front * speed * u);
    add_arm(row.wake_moment_y, hub, right * speed * v);
}

// Add torque, force in the plane and moments of the hub.
//
// acceleration: of the rotor [rad/s²].
// rates: of the body [rad/s].
inline void add_hub(const Hub& hub, double acceleration, const Vector3& rates, Regressors& row) {
    const double spin = hub.spin, speed = hub.speed, square = speed * speed, induced = hub.induced;
    const double u = hub.u, v = hub.v, w = hub.w, h = hub.in_plane;
    // The air turns the body against the rotor.
    row.torque[5] -= spin * square;
    row.torque_axial[5] -= spin * speed * w;
    row.torque_induced[5] -= spin * speed * induced;
    row.torque_advance[5] -= spin * speed * h;

    add_in_plane(row.rotor_drag, hub, -speed * u, -speed * v);
    add_in_plane(row.rotor_drag_advance, hub, -h * u, -h * v);
    add_in_plane(row.rotor_drag_axial, hub, -w * u, -w * v);
    add_in_plane(row.rotor_drag_induced, hub, -induced * u, -induced * v);
    const double across_x = -spin * v, across_y = spin * u;
    add_in_plane(row.rotor_side, hub, speed * across_x, speed * across_y);
    add_in_plane(row.rotor_side_advance, hub, h * across_x, h * across_y);
    add_in_plane(row.rotor_side_axial, hub, w * across_x, w * across_y);
    add_in_plane(row.rotor_side_induced, hub, induced * across_x, induced * across_y);

    add_moments(row.hub_height, speed * v, -speed * u);
    add_moments(row.hub_height_advance, h * v, -h * u);
    add_moments(row.hub_height_induced, induced * v, -induced * u);
    add_moments(row.hub_roll, spin * speed * u, spin * speed * v);
    add_moments(row.hub_roll_induced, spin * induced * u, spin * induced * v);

    row.incline_x[0] += square;
    row.incline_y[1] += square;
    row.gravity_centre_x[4] -= square;
    row.gravity_centre_y[3] += square;
    // What changes the angular momentum J s ω of the rotor about z is taken from the body.
    row.rotor_inertia_gyro[3] -= spin * speed * rates[1];
    row.rotor_inertia_gyro[4] += spin * speed * rates[0];
    row.rotor_inertia_spin[5] -= spin * acceleration;
}

// Add the terms of a rotor; returns its induced velocity [m/s].
inline double fill_rotor(
    int rotor, const MotionSample& motion, const PhysicalVehicle& vehicle, Regressors& row
) {
    const Hub hub = hub_of(rotor, motion, vehicle);
    add_thrusts(hub, row);
    add_unlike(rotor, static_cast<int>(vehicle.rotors), hub, row);
    add_hub(hub, motion.rotor_accelerations[rotor], motion.rates, row);
    return hub.induced;
}

// Set the terms of the airframe, for means over the rotors of speed [rad/s] and induced velocity [m/s].
inline void fill_airframe(double mean_speed, double induced, const MotionSample& motion, Regressors& row) {
    const auto [u, v, w] = motion.velocity;
    const auto [p, q, r] = motion.rates;
    const double speed = std::sqrt(u * u + v * v + w * w);
    row.body_x_speed[0] = -mean_speed * u, row.body_y_speed[1] = -mean_speed * v;
    row.body_x_induced[0] = -induced * u, row.body_y_induced[1] = -induced * v;
    row.body_x_cross[0] = -mean_speed * v, row.body_y_cross[1] = -mean_speed * u;
    row.body_x_downwash[0] = row.body_y_downwash[1] = induced * w;
    row.body_roll_downwash[3] = row.body_pitch_downwash[4] = induced * w;
    row.drag_x[0] = -u * std::abs(u), row.drag_y[1] = -v * std::abs(v), row.drag_z[2] = -w * std::abs(w);
    row.drag_x_speed[0] = -u * speed, row.drag_y_speed[1] = -v * speed, row.drag_z_speed[2] = -w * speed;
    row.lift_w_u[2] = -w * std::abs(u), row.lift_w_v[2] = -w * std::abs(v);
    row.lift_x[0] = u * w, row.lift_y[1] = v * w;
    row.pitch_u[4] = u * speed, row.pitch_uw[4] = u * w;
    row.roll_v[3] = v * speed, row.roll_vw[3] = v * w;
    row.yaw_uv[5] = u * v, row.yaw_v[5] = v * speed;
    row.damping_p[3] = -p * speed, row.damping_q[4] = -q * speed, row.damping_r[5] = -r * speed;
}

// Set the regressors of the position of the accelerometer, for a mass m [kg].
inline void fill_imu(const MotionSample& motion, double m, Regressors& row) {
    const auto [p, q, r] = motion.rates;
    // Acceleration of a point at d: α × d + Ω × (Ω × d).
    const auto [x, y, z] = motion.angular_acceleration;
    row.imu_x[0] = -m * (q * q + r * r), row.imu_x[1] = m * (z + p * q), row.imu_x[2] = m * (p * r - y);
    row.imu_y[0] = m * (p * q - z), row.imu_y[1] = -m * (p * p + r * r), row.imu_y[2] = m * (x + q * r);
    row.imu_z[0] = m * (y + p * r), row.imu_z[1] = m * (q * r - x), row.imu_z[2] = -m * (p * p + q * q);
}

// Set the terms beside those of single rotors, for their mean induced velocity [m/s].
inline void fill_body(
    double mean_induced, const MotionSample& motion, const PhysicalVehicle& vehicle, Regressors& row
) {
    const auto [p, q, r] = motion.rates;
    const double share = 1.0 / static_cast<double>(vehicle.rotors);
    double mean_speed = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        mean_speed += share * motion.rotor_speeds[rotor];
    }
    fill_airframe(mean_speed, mean_induced, motion, row);
    row.inertia_x[3] = q * r, row.inertia_y[4] = r * p, row.inertia_z[5] = p * q;
    row.bias_x[0] = row.bias_y[1] = row.bias_z[2] = 1.0;
    row.bias_roll[3] = row.bias_pitch[4] = row.bias_yaw[5] = 1.0;
    fill_imu(motion, vehicle.mass, row);
}

// The regressors of a sample.
inline void fill_regressors(const MotionSample& motion, const PhysicalVehicle& vehicle, Regressors& row) {
    row = {};
    const double share = 1.0 / static_cast<double>(vehicle.rotors);
    double mean_induced = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        mean_induced += share * fill_rotor(rotor, motion, vehicle, row);
    }
    fill_body(mean_induced, motion, vehicle, row);
}

}  // namespace quadpi
