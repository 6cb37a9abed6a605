/* SPDX-License-Identifier: MIT */
/* Stub of rclcpp for tests: README.md. STUB_DISTRO is the major version: 16 Humble, 28 Jazzy, 30 Rolling. */
#ifndef STUB_RCLCPP_VERSION_H
#define STUB_RCLCPP_VERSION_H

#define RCLCPP_VERSION_MAJOR STUB_DISTRO

#endif
