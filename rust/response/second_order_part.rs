//! Some of the pairs of causes of `second.rs`, and their values at a command.

use crate::shape::grid::Carry;
use crate::shape::modes::{accumulate, wide};
use std::ops::Range;

/// Some of the pairs of causes.
#[derive(Clone, Default)]
pub(super) struct Part {
    /// For each node: of every pair its mode weights (m,), then its stretch (n,) mm; then g_k of
    /// its own causes.
    pub(super) numbers: Vec<f64>,
    /// Pairs of causes, and the causes with a growth: indices among loads, then moduli, then
    /// tensions.
    pub(super) pairs: Vec<(usize, usize)>,
    pub(super) own: Vec<usize>,
}

impl Part {
    /// The pairs of loads and tensions, and those with a modulus: of each with loads, tensions and
    /// moduli from itself on.
    pub(super) fn both(loads: usize, moduli: usize, tendons: usize) -> [Part; 2] {
        let plain: Vec<usize> = (0..loads)
            .chain(loads + moduli..loads + moduli + tendons)
            .collect();
        let rows = |own: &[usize], k: usize| own.iter().map(move |l| (k, *l)).collect::<Vec<_>>();
        let among = (0..plain.len()).flat_map(|k| rows(&plain[k..], plain[k]));
        let own: Vec<usize> = (loads..loads + moduli).collect();
        let with =
            (0..moduli).flat_map(|i| [rows(&plain, own[i]), rows(&own[i..], own[i])].concat());
        let part = |pairs, own| Part {
            numbers: vec![],
            pairs,
            own,
        };
        [
            part(among.collect(), plain.clone()),
            part(with.collect(), own.clone()),
        ]
    }

    /// Number of values of a node, for a block size per pair.
    pub(super) fn size(&self, block: usize) -> usize {
        self.pairs.len() * block + self.own.len()
    }

    /// The values at a command, only for pairs with active causes.
    pub(super) fn at(
        &self,
        block: usize,
        carry: &Carry,
        acts: impl Fn(usize) -> bool,
        out: &mut [f64],
    ) {
        out.fill(0.0);
        if self.pairs.iter().all(|(k, l)| acts(*k) && acts(*l)) {
            return wide(
                #[inline(always)]
                || carry.blend(&self.numbers, 1.0, out),
            );
        }
        let mut wanted: Vec<Range<usize>> = vec![];
        for (p, (k, l)) in self.pairs.iter().enumerate() {
            match wanted.last_mut() {
                _ if !(acts(*k) && acts(*l)) => {}
                Some(range) if range.end == p * block => range.end += block,
                _ => wanted.push(p * block..(p + 1) * block),
            }
        }
        let size = out.len();
        wanted.push(self.pairs.len() * block..size);
        wide(
            #[inline(always)]
            || {
                for (node, share) in carry.nodes() {
                    let row = &self.numbers[node * size..(node + 1) * size];
                    for range in &wanted {
                        accumulate(&mut out[range.clone()], &row[range.clone()], *share);
                    }
                }
            },
        );
    }
}
