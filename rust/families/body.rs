//! Body: the robot's design differs from the model (stiffness along and across, rest shape, tendon
//! routing).

use super::declaration::*;

pub static FAMILY: Family = Family {
    name: "body",
    kind: Kind::Static,
    doc: "Stiffness, rest shape or tendon routing differ from the model, so the shape along the \
        body is wrong.",
    experiment: (
        "the same moves in two orientations, declared in the run",
        3.0,
    ),
    mimics: &["static map", "coupling", "static shape"],
    members: &[
        "stiffness",
        "stiffness_gradient",
        "stiff_section",
        "one_sided_stiffness",
        "kink",
        "twist",
        "pre_curve",
        "routing",
        "contact",
    ],
    fields: &[
        "stiffness_gradient",
        "stiff_section",
        "one_sided_stiffness",
        "twist",
        "pre_curve",
        "routing",
    ],
    modulation: by_command,
    ..NOTHING
};
