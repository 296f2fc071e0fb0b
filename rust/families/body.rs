//! Body: the robot's own design differs from the model's (stiffness along and across it, rest shape, routing of tendons).

use super::declaration::*;

pub static FAMILY: Family = Family {
    name: "body",
    kind: Kind::Static,
    doc: "The body is softer, stiffer or bent otherwise than the model's at some place, so the shape is wrong along it.",
    mimics: &["static map", "coupling", "static shape"],
    members: &[
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
