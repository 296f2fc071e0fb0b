//! Effects: each is declared once, in its own file; the list below is the registry.
//!
//! To add one, write `NAME.rs` next to the others with `pub static EFFECT: Effect` and put its name
//! in the list below. Chains, fits, the effects page and the tests loop over the list.

mod chain;
mod conditions;
mod declaration;
mod elapsed;
mod low_pass;
mod own;
mod pair;

pub use chain::Chain;
pub use conditions::{Camera, Conditions, Context, bracket};
pub use declaration::*;
pub(crate) use low_pass::low_pass;
pub use own::{forget, register, registry};

macro_rules! registry {
    ($($name:ident)*) => {
        $(mod $name;)*

        /// Every effect of the library, in stage order; [`registry`] holds those of users too.
        pub static REGISTRY: &[&Effect] = &[$(&$name::EFFECT),*];
    };
}

registry! {
    servo_swap
    saturation
    offset
    gain
    latency
    rate_limit
    lag
    eccentric_pulley
    backlash
    friction
    coupling
    slack
    dead_zone
    tendon_creep
    anchor_slip
    zero_drift
    hysteresis
    creep
    mullins
    thermal_softening
    asymmetry
    body_friction
    tendon_stretch
    routing
    gravity
    payload
    stiffness
    stiffness_gradient
    stiff_section
    one_sided_stiffness
    kink
    twist
    pre_curve
    contact
    lens
    scale
    mount
    camera_drift
    clock_shift
}

/// The effect of that name.
pub fn find(name: &str) -> Option<&'static Effect> {
    registry()
        .into_iter()
        .find(|effect| effect.declaration.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn declarations_are_complete_and_in_stage_order() {
        for pair in REGISTRY.windows(2) {
            assert!(
                pair[0].declaration.stage <= pair[1].declaration.stage,
                "{:?} {:?}",
                pair[0],
                pair[1]
            );
        }
        for effect in REGISTRY {
            let d = &effect.declaration;
            assert_eq!(
                find(d.name).map(|found| found.declaration.name),
                Some(d.name)
            );
            for p in d.parameters {
                assert!(
                    p.low < p.high && p.low <= p.start && p.start <= p.high,
                    "{}.{}",
                    d.name,
                    p.name
                );
                assert!(
                    [p.null, p.start, p.low, p.high]
                        .iter()
                        .all(|value| value.is_finite())
                );
            }
        }
    }
}
