//! The response of a body to loads at a command: the weights of its fields, the tension changes of
//! its cables, and second-order terms.
//!
//! Loads (`loads.rs`) stretch the cables; the resulting tension changes also move the body
//! (`cables.rs`), and dead loads and changes of the modulus have second-order terms (`second.rs`).
//! The data of all three at a command are read first (`at`): its *place*. Fields, stretches and
//! second derivatives enter linearly. So a body under the same loads at all commands is one with
//! two or three loads (`under`): tens of numbers per place instead of hundreds.

use crate::algebra::complementarity::Problem;
use crate::error::Result;
use crate::response::cables::Cables;
use crate::response::loads::{FIELDS, LOADS, MODULI};
use crate::response::second_order::{MOST_TENDONS, Second};
use crate::shape::grid::Nodes;

/// The data of a body besides its fields.
#[derive(Clone)]
pub struct Answer {
    pub cables: Option<Cables>,
    pub second: Option<Second>,
    /// Number of loads and changes of design, and of the first ones with second-order terms.
    loads: usize,
    known: usize,
}

/// Workspace at a place.
#[derive(Default)]
pub struct Scratch {
    /// Second-order stretch of each cable (n,) mm.
    pub beyond: Vec<f64>,
    problem: Problem,
}

impl Answer {
    /// The response to the loads of `loads.rs`.
    pub fn new(cables: Option<Cables>, second: Option<Second>) -> Answer {
        Answer {
            loads: FIELDS.len(),
            known: second.as_ref().map_or(LOADS, Second::known),
            cables,
            second,
        }
    }

    /// The amounts (FIELDS,) of the few loads of a body under `loads` (FIELDS,): the dead loads,
    /// the changes of the modulus if the second order has them, and the other changes of design.
    pub fn few(&self, loads: &[f64]) -> Vec<Vec<f64>> {
        let ends = [0, LOADS, self.known, FIELDS.len()];
        let some = ends.windows(2).map(|w| {
            let mut some = vec![0.0; FIELDS.len()];
            some[w[0]..w[1]].copy_from_slice(&loads[w[0]..w[1]]);
            some
        });
        let mut few: Vec<Vec<f64>> = some.collect();
        if few[1].iter().all(|p| *p == 0.0) {
            few.remove(1);
        }
        few
    }

    /// The same with few loads, which are `few(loads)` of its own.
    pub fn under(&self, few: &[&[f64]], loads: &[f64]) -> Result<Answer> {
        let cables = self.cables.as_ref().map(|cables| cables.under(few));
        let second = self.second.as_ref();
        Ok(Answer {
            cables: cables.transpose()?,
            second: second.map(|second| second.under(&loads[..self.known])),
            loads: few.len(),
            known: few.len() - 1,
        })
    }

    /// Number of responding cables.
    pub fn tendons(&self) -> usize {
        self.cables.as_ref().map_or(0, Cables::count)
    }

    fn split(&self) -> usize {
        self.cables.as_ref().map_or(0, Cables::size)
    }

    /// Numbers of a place.
    pub fn size(&self) -> usize {
        self.split() + self.second.as_ref().map_or(0, Second::size)
    }

    /// The place at a command: the state of the cables, then the second-order terms of the loads
    /// and moduli in `there`.
    pub fn at(
        &self,
        u: &[f64],
        nodes: &mut Nodes,
        there: &[bool],
        out: &mut [f64],
        work: &mut Scratch,
    ) {
        let (cables, second) = out.split_at_mut(self.split());
        if let Some(known) = &self.cables {
            known.at(u, nodes, cables, &mut work.problem);
        }
        if let Some(known) = &self.second {
            known.at(u, nodes, there, second);
        }
    }

    /// The cables' part of a place.
    pub fn cables_at<'a>(&self, place: &'a [f64]) -> Option<(&Cables, &'a [f64])> {
        self.cables
            .as_ref()
            .map(|known| (known, &place[..self.split()]))
    }

    /// Write the weights of the fields to `weights`: the loads, the tension changes (N), the
    /// second-order terms. `gives` (mm/N) is the additional compliance of the cables of each
    /// command and side; `place` is the result of `at`.
    pub fn weigh(
        &self,
        loads: &[f64],
        gives: &[f64],
        place: &[f64],
        weights: &mut [f64],
        work: &mut Scratch,
    ) {
        let Scratch { beyond, problem } = work;
        let (own, rest) = weights.split_at_mut(self.loads);
        own.copy_from_slice(loads);
        rest.fill(0.0);
        beyond.clear();
        let acts = gives.iter().any(|g| *g != 0.0) || loads.iter().any(|c| *c != 0.0);
        let (change, modes) = rest.split_at_mut(self.tendons());
        let cables = self.cables_at(place).filter(|_| acts);
        let large =
            gives.iter().any(|g| *g != 0.0) || loads[..self.known].iter().any(|c| *c != 0.0);
        if let (Some(known), true) = (&self.second, large) {
            let mut amount = [0.0; LOADS + MODULI + MOST_TENDONS];
            let amount = &mut amount[..self.known + change.len()];
            amount[..self.known].copy_from_slice(&loads[..self.known]);
            if let Some((cables, at)) = cables {
                let mut alone = [0.0; FIELDS.len()];
                alone[..self.known].copy_from_slice(&loads[..self.known]);
                cables.answer(at, &alone[..self.loads], gives, &[], change, problem);
                amount[self.known..].copy_from_slice(change);
            }
            beyond.resize(known.tendons(), 0.0);
            known.beyond(&place[self.split()..], amount, modes, beyond);
        }
        if let Some((cables, at)) = cables {
            cables.answer(at, loads, gives, beyond, change, problem);
        }
    }
}
