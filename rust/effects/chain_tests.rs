//! Invariants of every chain: splitting a record, bounded responses, batch equals members.

use super::*;
use crate::effects::Conditions;
use proptest::prelude::*;

fn chain(channels: usize) -> Chain {
    let names: Vec<String> = super::super::REGISTRY
        .iter()
        .map(|effect| effect.declaration.name.to_string())
        .collect();
    Chain::new(&names, channels).unwrap()
}

fn params(chain: &Chain, pick: impl Fn(&Parameter) -> f64) -> Vec<f64> {
    chain.parameters().iter().map(|(_, p)| pick(p)).collect()
}

fn world(t: Vec<f64>) -> Conditions {
    Conditions::new(t, vec![[0.0, 0.0, 1.0]], vec![0.0], vec![f64::NAN]).unwrap()
}

proptest! {
    #[test]
    fn splitting_a_record_changes_nothing(
        u in proptest::collection::vec(-15.0..15.0f64, 80), gaps in proptest::collection::vec(0.0..0.3f64, 40), at in 0..40usize,
    ) {
        let chain = chain(2);
        let t: Vec<f64> = gaps.iter().scan(0.0, |sum, gap| { *sum += gap; Some(*sum) }).collect();
        let p = params(&chain, |p| 0.5 * (p.null + p.high));
        let whole = chain.rollout(&p, &u, &mut world(t.clone()), &mut vec![]).unwrap();
        let mut state = chain.init(&p, &u[..2]).unwrap();
        let mut parts = chain.rollout(&p, &u[..2 * at], &mut world(t[..at].to_vec()), &mut state).unwrap();
        parts.extend(chain.rollout(&p, &u[2 * at..], &mut world(t[at..].to_vec()), &mut state).unwrap());
        prop_assert_eq!(whole, parts);
    }

    #[test]
    fn whatever_comes_in_stays_bounded(
        u in proptest::collection::vec(-30.0..30.0f64, 120), gaps in proptest::collection::vec(0.0..50.0f64, 60), share in 0.0..1.0f64,
    ) {
        let chain = chain(2);
        let t: Vec<f64> = gaps.iter().scan(0.0, |sum, gap| { *sum += gap; Some(*sum) }).collect();
        let p = params(&chain, |p| p.low + share * (p.high - p.low));
        let out = chain.rollout(&p, &u, &mut world(t), &mut vec![]).unwrap();
        // Offset 4 mm, gain 1.3, a pulley 6 mm, play 2 mm, coupling 1.3, routing 1.4, a slip 4 mm,
        // held back 0.7·6.25 mm; creep, softening and asymmetry 1.5, 1.5, 1.4.
        let most = ((34.0 * 1.3 + 6.0 + 2.0) * 1.3 * 1.4 + 4.0 + 4.5) * 1.5 * 1.5 * 1.4;
        prop_assert!(out.iter().all(|x| x.abs() <= most));
    }
}

#[test]
fn a_batch_is_its_members() {
    let chain = chain(2);
    let t: Vec<f64> = (0..50).map(|k| 0.03 * k as f64).collect();
    let u: Vec<f64> = (0..100).map(|k| 9.0 * (0.13 * k as f64).sin()).collect();
    let sets = [
        params(&chain, |p| p.null),
        params(&chain, |p| p.start),
        params(&chain, |p| p.high),
    ];
    let batch = chain
        .rollout(&sets.concat(), &u, &mut world(t.clone()), &mut vec![])
        .unwrap();
    for (set, out) in sets.iter().zip(batch.chunks_exact(100)) {
        assert_eq!(
            chain
                .rollout(set, &u, &mut world(t.clone()), &mut vec![])
                .unwrap(),
            out
        );
    }
    assert_eq!(batch[..100], u, "null is the identity");
}

#[test]
fn sets_that_begin_alike_act_as_each_by_itself() {
    let chain = chain(2);
    let t: Vec<f64> = (0..50).map(|k| 0.03 * k as f64).collect();
    let u: Vec<f64> = (0..100).map(|k| 9.0 * (0.13 * k as f64).sin()).collect();
    let (conditions, start) = (world(t), params(&chain, |p| p.start));
    let mut sets = vec![start.clone(), start.clone()];
    for (i, (_, parameter)) in chain.parameters().into_iter().enumerate() {
        let mut moved = start.clone();
        moved[i] = parameter.high;
        sets.push(moved);
    }
    let rows = [(0, 0.0), (7, 0.25), (31, 0.0), (48, 0.9)];
    let acting = |sets: &[Vec<f64>]| {
        let places = vec![&rows[..]; sets.len()];
        chain
            .acting(&sets.concat(), &u, &conditions, &places)
            .unwrap()
    };
    let width = rows.len() * (2 + chain.remembered());
    for (set, together) in sets.iter().zip(acting(&sets).chunks_exact(width)) {
        assert_eq!(acting(std::slice::from_ref(set)), together);
        let whole = chain.rollout(set, &u, &mut world(conditions.t().to_vec()), &mut vec![]);
        let third = &together[width / 2..];
        assert_eq!(whole.unwrap()[62..64], third[..2]);
    }
}

#[test]
fn names_sort_themselves_and_mistakes_are_reported() {
    let names = |list: &[&str]| list.iter().map(|name| name.to_string()).collect::<Vec<_>>();
    let chain = Chain::new(&names(&["mount", "backlash", "gain"]), 2).unwrap();
    assert_eq!(chain.names(), ["gain", "backlash", "mount"]);
    assert_eq!(chain.parameters()[1].0, "gain.factor[1]");
    let unknown = Chain::new(&names(&["gian"]), 2).unwrap_err().to_string();
    assert!(unknown.contains("'gian'") && unknown.contains("payload"));
    assert!(Chain::new(&names(&["lag", "lag"]), 2).is_err());
    assert!(chain.check(&[f64::NAN; 9]).is_err());
    let backwards = Conditions::new(vec![1.0, 0.5], vec![[0.0; 3]], vec![0.0], vec![0.0]);
    assert!(backwards.unwrap_err().to_string().contains("backwards"));
}
