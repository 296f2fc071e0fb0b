//! Frame: the sensor sees the robot from elsewhere than the model believes (turned, shifted, scaled).

use super::declaration::*;

pub static FAMILY: Family = Family {
    name: "frame",
    kind: Kind::Static,
    doc: "All that is seen is turned, shifted or scaled, the clamped base too: the measurement is off, not the robot.",
    mimics: &["static shape"],
    members: &["mount", "scale", "lens"],
    fields: &["mount", "scale"],
    ..NOTHING
};
