//! Registry of effect families: one file per family, declared like the effects in `rust/effects/`.
//!
//! To add a family, write `NAME.rs` with `pub static FAMILY: Family` and add its name to the list
//! below. Level 1 of the diagnosis, the tests and the documentation loop over this list.

mod bank;
mod declaration;
mod gram;
mod level;
mod operators;
mod series;

pub use bank::Bank;
pub use declaration::{Family, Kind};
pub use level::{FrameSet, Level};
pub use series::Series;

macro_rules! registry {
    ($($name:ident)*) => {
        $(mod $name;)*

        /// Every family.
        pub static REGISTRY: &[&Family] = &[$(&$name::FAMILY),*];
    };
}

registry! {
    static_map
    coupling
    memory
    delay
    rate
    creep
    softening
    time
    step
    temperature
    load
    frame
    frame_drift
    body
    static_shape
}

/// The family of that name.
pub fn find(name: &str) -> Option<&'static Family> {
    REGISTRY.iter().copied().find(|family| family.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects;

    /// Gross faults are checked before level 1, so they belong to no family.
    const GROSS_FAULTS: [&str; 1] = ["servo_swap"];

    #[test]
    fn declarations_are_complete_and_mimics_are_mutual() {
        for family in REGISTRY {
            let name = family.name;
            assert_eq!(find(name).map(|found| found.name), Some(name));
            assert!(family.doc.ends_with('.'), "{name}: one sentence for users");
            assert!(family.columns.is_some() || family.has_fields(), "{name}");
            for other in family.mimics {
                let back = find(other).map(|other| other.mimics.contains(&name));
                assert_eq!(back, Some(true), "{name} mimics {other}");
                let separated = find(other).is_some_and(|other| !other.experiment.0.is_empty());
                assert!(
                    separated || !family.experiment.0.is_empty(),
                    "{name}: nothing separates it from {other}"
                );
            }
            for effect in family.members.iter().chain(family.fields) {
                assert!(
                    effects::find(effect).is_some(),
                    "{name}: no effect {effect}"
                );
            }
        }
    }

    #[test]
    fn every_effect_of_the_library_is_a_member_of_a_family() {
        for effect in effects::REGISTRY {
            let name = effect.declaration.name;
            let member = REGISTRY.iter().any(|family| family.members.contains(&name));
            assert_eq!(member, !GROSS_FAULTS.contains(&name), "{name}");
        }
    }
}
