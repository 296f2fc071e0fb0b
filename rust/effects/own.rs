//! User-defined effects, added at run time: a list besides the library's.
//!
//! A name identifies one effect: a used name is rejected until it is removed. A chain keeps the
//! effects that it was composed with, also after their removal; so their few hundred bytes are
//! never freed.

use super::REGISTRY;
use super::declaration::{Declaration, Effect, Law, RecordEffect, Stage};
use crate::error::{Result, invalid};
use std::sync::{PoisonError, RwLock};

static OWN: RwLock<Vec<&'static Effect>> = RwLock::new(Vec::new());

/// All current effects, in stage order; within a stage, those of the library come first.
pub fn registry() -> Vec<&'static Effect> {
    let own = OWN.read().unwrap_or_else(PoisonError::into_inner);
    let mut all: Vec<_> = REGISTRY.iter().chain(own.iter()).copied().collect();
    all.sort_by_key(|effect| effect.declaration.stage);
    all
}

/// Add a user's effect. It changes commands, so its stage is one of those before the shape.
pub fn register(declaration: Declaration, law: Box<dyn RecordEffect>) -> Result<()> {
    let name = declaration.name;
    if declaration.stage >= Stage::Shape {
        return Err(invalid(format!(
            "the effect '{name}' is of the stage {}; a user's effect changes commands: command, \
            transmission or material",
            declaration.stage.name()
        )));
    }
    for p in declaration.parameters {
        let finite = [p.null, p.start, p.low, p.high]
            .iter()
            .all(|x| x.is_finite());
        if !(finite && p.low < p.high && p.low <= p.start && p.start <= p.high) {
            return Err(invalid(format!(
                "{name}.{} has null {}, start {}, low {}, high {}; expected finite numbers with \
                 low <= start <= high and low < high",
                p.name, p.null, p.start, p.low, p.high
            )));
        }
    }
    let mut own = OWN.write().unwrap_or_else(PoisonError::into_inner);
    if REGISTRY
        .iter()
        .chain(own.iter())
        .any(|effect| effect.declaration.name == name)
    {
        return Err(invalid(format!(
            "there is an effect '{name}' already; give yours another name"
        )));
    }
    own.push(Box::leak(Box::new(Effect {
        declaration,
        law: Law::Record(Box::leak(law)),
    })));
    Ok(())
}

/// Remove a user's effect from the list.
pub fn forget(name: &str) -> Result<()> {
    let mut own = OWN.write().unwrap_or_else(PoisonError::into_inner);
    let before = own.len();
    own.retain(|effect| effect.declaration.name != name);
    if own.len() == before {
        return Err(invalid(format!(
            "'{name}' is no effect that was registered here; nothing is forgotten"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Chain, Conditions, Kind, Parameter};

    struct Twice;

    impl RecordEffect for Twice {
        fn rollout(&self, p: &[f64], samples: &mut [f64], _: usize, _: &Conditions) -> Result<()> {
            if p[0] > 2.0 {
                return Err(invalid("too much"));
            }
            samples.iter_mut().for_each(|x| *x *= 1.0 + p[0]);
            Ok(())
        }
    }

    static PARAMETERS: [Parameter; 1] = [Parameter::new(
        "by",
        "1",
        0.0,
        1.0,
        -1.0,
        3.0,
        "how much more",
    )];

    fn declaration(name: &'static str, stage: Stage) -> Declaration {
        Declaration {
            name,
            family: "own",
            stage,
            kind: Kind::Effect,
            formula: "",
            doc: "",
            signature: "",
            reference: "",
            experiment: ("", 1.0),
            alike: &[],
            needs: &[],
            parameters: &PARAMETERS,
        }
    }

    #[test]
    fn a_registered_effect_joins_chains_before_what_follows_and_refuses_steps() {
        register(declaration("twice", Stage::Transmission), Box::new(Twice)).unwrap();
        let names = ["creep", "twice", "gain"].map(String::from);
        let chain = Chain::new(&names, 1).unwrap();
        assert_eq!(chain.names(), ["gain", "twice", "creep"]);
        assert_eq!(chain.acting_width(), chain.width());
        let world = || Conditions::new(vec![0.0, 5.0], vec![[0.0; 3]], vec![0.0], vec![0.0]);
        // gain 1, doubled, and creep that has settled under the doubled command.
        let params = [1.0, 1.0, 0.5, 10.0, 3.0];
        let params = &params[..chain.width()];
        let out = chain
            .rollout(params, &[4.0, 4.0], &mut world().unwrap(), &mut vec![])
            .unwrap();
        assert_eq!(out, [12.0, 12.0]);
        let mut states = vec![0.0; chain.state_size()];
        for refused in [
            chain
                .rollout(params, &[4.0, 4.0], &mut world().unwrap(), &mut states)
                .unwrap_err(),
            chain.init(params, &[4.0]).unwrap_err(),
            chain.stepwise().unwrap_err(),
        ] {
            assert!(
                refused.to_string().contains("'twice' is a Python effect"),
                "{refused}"
            );
        }
        let mut wrong = params.to_vec();
        wrong[1] = 2.5;
        let failed = chain.rollout(&wrong, &[4.0, 4.0], &mut world().unwrap(), &mut vec![]);
        assert_eq!(failed.unwrap_err().to_string(), "too much");
        assert!(register(declaration("twice", Stage::Material), Box::new(Twice)).is_err());
        assert!(register(declaration("gain", Stage::Material), Box::new(Twice)).is_err());
        assert!(register(declaration("roll", Stage::Sensing), Box::new(Twice)).is_err());
        forget("twice").unwrap();
        assert!(forget("twice").is_err() && forget("gain").is_err());
        assert!(Chain::new(&names, 1).is_err());
        assert_eq!(chain.names(), ["gain", "twice", "creep"]); // what is composed stays
    }
}
