const char *stiffgen_impedance_error_text(int code)
{
    switch (code) {
    case STIFFGEN_OK:
        return "no error";
    case STIFFGEN_E_SIZE:
        return "size: the number of joints must lie between 1 and STIFFGEN_MAX_DOF";
    case STIFFGEN_E_NOT_FINITE:
        return "a matrix holds NaN or infinity, or numbers too far apart for a double";
    case STIFFGEN_E_MASS:
        return "the mass matrix is not positive definite";
    case STIFFGEN_E_NOT_SYMMETRIC:
        return "a matrix that must be symmetric is not";
    case STIFFGEN_E_NOT_CONVERGED:
        return "the eigensolver used up its sweeps";
    case STIFFGEN_E_DAMPING_RATIO:
        return "a damping ratio is negative or not finite";
    case STIFFGEN_E_NULL:
        return "a pointer is NULL";
    case STIFFGEN_E_NOT_INITIALISED:
        return "the state is not initialised: call NAME_impedance_init first";
    case STIFFGEN_E_CONFIG_SAMPLE_TIME:
        return "sample_time: must be positive and at most 0.1 s";
    case STIFFGEN_E_CONFIG_REPRESENTATION:
        return "representation: must be body, spatial or hybrid";
    case STIFFGEN_E_CONFIG_STIFFNESS_FORMULA:
        return "stiffness_formula: must be corrected or conventional";
    case STIFFGEN_E_CONFIG_STIFFNESS_SIGN:
        return "stiffness_sign: must be as_is or positive_part, and as_is with the conventional formula";
    case STIFFGEN_E_CONFIG_STIFFNESS_RATE:
        return "stiffness_rate_limit: must be positive and finite";
    case STIFFGEN_E_CONFIG_NULLSPACE:
        return "nullspace: must be off, isotropic or projected";
    case STIFFGEN_E_CONFIG_NULLSPACE_STIFFNESS:
        return "nullspace_stiffness: must be positive with a nullspace stiffness and 0 without, and finite";
    case STIFFGEN_E_CONFIG_SINGULARITY_THRESHOLD:
        return "singularity_threshold: must lie between 1e-9 and 1";
    case STIFFGEN_E_CONFIG_DAMPING_DESIGN:
        return "damping_design: must be modal, factorised or task";
    case STIFFGEN_E_CONFIG_DAMPING_RATIO:
        return "damping_ratio: every entry must lie between 0 and 100";
    case STIFFGEN_E_CONFIG_TASK_DAMPING:
        return "task_damping: must be symmetric, positive semidefinite and finite, and 0 unless the design is task";
    case STIFFGEN_E_CONFIG_JOINT_DAMPING:
        return "joint_damping: must be 0 or more, and finite";
    case STIFFGEN_E_CONFIG_WRENCH_FILTER:
        return "wrench_filter: must be off, first_order or moving_average";
    case STIFFGEN_E_CONFIG_WRENCH_TIME_CONSTANT:
        return "wrench_time_constant: must be positive and finite";
    case STIFFGEN_E_CONFIG_WRENCH_WINDOW:
        return "wrench_window: must lie between 1 and STIFFGEN_MAX_WINDOW samples";
    case STIFFGEN_E_CONFIG_POSITION_LIMITS:
        return "lower_limit, upper_limit: lower must be below upper for every joint";
    case STIFFGEN_E_CONFIG_POSITION_TOLERANCE:
        return "position_tolerance: must be 0 or more, and finite";
    case STIFFGEN_E_CONFIG_VELOCITY_LIMIT:
        return "velocity_limit: must be positive and finite for every joint (the URDF may have none: set it)";
    case STIFFGEN_E_CONFIG_WRENCH_LIMITS:
        return "force_limit, moment_limit: must be positive and finite";
    case STIFFGEN_E_CONFIG_TASK_STIFFNESS_LIMIT:
        return "task_stiffness_limit: must be positive and at most 1e9";
    case STIFFGEN_E_CONFIG_LIMIT_ZONE:
        return "limit_zone: must be positive, finite and less than half of every joint's range";
    case STIFFGEN_E_CONFIG_LIMIT_STIFFNESS:
        return "limit_stiffness: must be 0 or more, and finite, for every joint";
    case STIFFGEN_E_CONFIG_EFFORT_LIMIT:
        return "effort_limit: must be positive and finite for every joint (the URDF may have none: set it)";
    case STIFFGEN_E_CONFIG_TORQUE_RATE_LIMIT:
        return "torque_rate_limit: must be positive and finite for every joint";
    case STIFFGEN_E_CONFIG_MISSED_LIMIT:
        return "missed_limit: must lie between 1 and 1000 samples";
    case STIFFGEN_E_CONFIG_VELOCITY_DECAY_TIME:
        return "velocity_decay_time: must be positive and finite";
    case STIFFGEN_E_CONFIG_RETURN_TIME:
        return "return_time: must be 0 or more, and finite";
    case STIFFGEN_E_CONFIG_TANK:
        return "tank: must be off or on, and off with the conventional formula, which no tank can make passive";
    case STIFFGEN_E_CONFIG_TANK_ENERGY:
        return "tank_minimum <= tank_initial <= tank_maximum must hold, with tank_minimum 0 or more and all finite";
    case STIFFGEN_E_CONFIG_TANK_REFILL:
        return "tank_refill: must lie between 0 and 1";
    default:
        return "unknown error";
    }
}
