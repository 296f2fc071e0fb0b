//! Frame: the sensor frame is rotated, shifted or scaled relative to the model.

use super::declaration::*;

pub static FAMILY: Family = Family {
    name: "frame",
    kind: Kind::Static,
    doc: "Everything measured is rotated, shifted or scaled, the clamped base included: a \
        measurement fault.",
    experiment: ("points near the base, home revisits", 0.5),
    mimics: &["static shape"],
    members: &["mount", "scale", "lens"],
    fields: &["mount", "scale"],
    ..NOTHING
};
