//! The predictor: frames between samples, sets with shared shapes, and errors for missing fields.

use super::*;
use crate::shape::table::Table;

fn plane(slope: [f64; 3]) -> Arc<dyn Shape> {
    let ends = slope.iter().map(|s| -s).chain(slope).collect();
    let modes = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    Arc::new(Table::new(vec![vec![-1.0, 1.0]], ends, vec![0.0; 3], modes).unwrap())
}

fn predictor(fields: &[&str]) -> Predictor {
    let fields = fields
        .iter()
        .map(|name| (name.to_string(), plane([0.0, 1.0, 0.0])))
        .collect();
    Predictor::new(
        plane([1.0, 0.0, 2.0]),
        fields,
        None,
        None,
        vec![true],
        [0.0, 0.0, 1.0],
    )
    .unwrap()
}

fn world(gravity: [f64; 3], load: f64) -> Conditions {
    Conditions::new(vec![0.0, 1.0], vec![gravity], vec![load], vec![f64::NAN]).unwrap()
}

#[test]
fn frames_lie_between_samples_and_sets_that_share_shapes_agree_with_single_ones() {
    let names = ["offset", "payload", "mount"].map(String::from);
    let chain = Chain::new(&names, 1).unwrap();
    let body = predictor(&["tip_force_z"]);
    let sets = [
        [0.0; 8],
        [0.5, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        [0.5, 40.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0],
        [0.5, 40.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0],
    ];
    let run = |params: &[f64]| {
        body.predict(
            &chain,
            params,
            &[2.0, 4.0],
            &world([0.0, 0.0, 1.0], 10.0),
            &[0.25, 5.0],
        )
        .unwrap()
    };
    let batch = run(&sets.concat());
    for (set, frames) in sets.iter().zip(batch.chunks_exact(6)) {
        assert_eq!(run(set), frames);
    }
    let declared = 0.01 * 9.80665;
    assert!((batch[0] - 2.5).abs() < 1e-12 && (batch[1] - declared * 2.5).abs() < 1e-12);
    assert!((batch[3] - 4.0).abs() < 1e-12, "held beyond the end");
    assert!(
        (batch[7] - 3.0 * declared * 3.0).abs() < 1e-12 && (batch[8] - (6.0 + 1.0)).abs() < 1e-12
    );
}

#[test]
fn slopes_are_those_of_the_shape_and_what_acts_is_what_the_chain_gives() {
    let chain = Chain::new(&["offset".to_string()], 1).unwrap();
    let body = predictor(&[]);
    let (u, seen) = ([2.0, 4.0], [0.25, 0.5, 5.0]);
    let still = world([0.0, 0.0, 1.0], 0.0);
    let acting = body
        .acting(&chain, &[0.5, 1.0, 0.5], &u, &still, &seen)
        .unwrap();
    assert_eq!(acting, [3.0, 3.5, 4.5, 3.5, 4.0, 5.0, 3.0, 3.5, 4.5]);
    let slopes = |step: f64| body.slopes(&chain, &[0.5], &[step], &u, &still, &seen);
    for (got, known) in slopes(0.3).unwrap().iter().zip([1.0, 0.0, 2.0].repeat(3)) {
        assert!((got - known).abs() < 1e-12);
    }
    assert!(slopes(0.0).is_err() && slopes(f64::NAN).is_err());
}

#[test]
fn absent_fields_and_foreign_chains_are_reported() {
    let chain = Chain::new(&["payload".to_string()], 1).unwrap();
    let body = predictor(&[]);
    let error = |params: f64, gravity, load| {
        body.predict(
            &chain,
            &[params],
            &[0.0, 1.0],
            &world(gravity, load),
            &[0.5],
        )
        .err()
        .map(|e| e.to_string())
    };
    assert_eq!(error(0.0, [0.0, 0.0, 1.0], 0.0), None);
    assert!(
        error(5.0, [0.0, 0.0, 1.0], 0.0)
            .unwrap()
            .contains("payload")
    );
    assert!(
        error(0.0, [1.0, 0.0, 0.0], 0.0)
            .unwrap()
            .contains("gravity_x")
    );
    let other = Chain::new(&[], 2).unwrap();
    assert!(
        body.predict(&other, &[], &[0.0; 4], &world([0.0, 0.0, 1.0], 0.0), &[0.5])
            .is_err()
    );
}

#[test]
fn a_prior_of_unknown_stiffness_leaves_declared_loads_to_the_effects() {
    let chain = |names: &[&str]| {
        Chain::new(&names.iter().map(|n| n.to_string()).collect::<Vec<_>>(), 1).unwrap()
    };
    let run = |body: &Predictor, chain: &Chain, params: &[f64]| {
        let world = world([0.0, 0.0, 1.0], 10.0);
        body.predict(chain, params, &[2.0, 4.0], &world, &[0.0])
            .unwrap()
    };
    let fields = ["tip_force_z"];
    let (plain, unknown) = (chain(&[]), predictor(&fields).without_declared_loads());
    let still = run(&predictor(&fields), &plain, &[])[1] - run(&unknown, &plain, &[])[1];
    assert!(
        still > 0.1,
        "the declared 10 g act on a model that knows its stiffness: {still}"
    );
    // The effect finds what was not declared to the model: 10 g of its own do the same.
    let found = run(&unknown, &chain(&["payload"]), &[10.0])[1];
    assert!((found - run(&predictor(&fields), &plain, &[])[1]).abs() < 1e-12);
}
