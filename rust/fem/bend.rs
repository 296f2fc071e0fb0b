//! Second derivatives of an equilibrium by loads, moduli and tensions, for large causes.
//!
//! With the residual r(x, λ), λ the dead loads, the changes of the modulus and the tensions, and
//! x_k = dx/dλ_k at constant other tensions (`sweep.rs`),
//!   x_kl = −K⁻¹ D²r(k, l),   D²r(k, l) = ½ [q(k + l) − q(k) − q(l)],   q(d) = [r(+d) + r(−d) − 2
//!     r(0)]/h²,
//! where d moves the nodes along h·x_k and the tensions along h·e_k: dead loads are linear, so only
//! elements and cables are assembled. A modulus p_k adds ∂(∂r/∂p_k)/∂x·x_l, a central difference,
//! for each l, and two of them ∂²r/∂p_k∂p_l (`moduli.rs`). The second derivative of a cable's
//! length is the same difference of lengths plus b·x_kl. Steps are REACH mm long; the error is
//! their square: 1e-4. Units: mm, N, g. Limit: as for fields, an indefinite K at constant tension
//! is shifted.

use super::Vec3;
use super::change::add_parts;
use super::moduli::Moduli;
use super::newton::{Solver, State};
use super::progress::Progress;
use super::solid::Solid;
use super::sweep::Simulation;
use super::work::inner;
use crate::error::Result;
use crate::response::loads::{LOADS, TIP_FORCE};

/// Largest motion of a node in a difference, mm.
const REACH: f64 = 0.1;

/// Second derivatives at one equilibrium, for each pair (k ≤ l) of `loads::LOADS`, the moduli and
/// the tensions, row by row.
#[derive(Debug, Clone, Default)]
pub struct Bend {
    /// Displacements of the points per unit of both.
    pub fields: Vec<Vec<Vec3>>,
    /// Stretch of each cable under the same, mm: rows (cables, pairs).
    pub stretch: Vec<f64>,
    /// Relative growth of the responses to gravity, to a force on the tip and to the tensions (each
    /// kind alike) per unit of each cause: g_k = ⟨x_l, x_kl⟩/⟨x_l, x_l⟩, sums over the causes l of
    /// a kind, over all unknowns.
    pub growth: Vec<f64>,
}

/// One cause: its motion of the unknowns per unit, and its modulus or tension.
struct Cause {
    step: Vec<f64>,
    modulus: Option<usize>,
    cable: Option<usize>,
    /// Units that move the nodes by REACH.
    amount: f64,
}

impl Simulation {
    /// The second derivatives at the equilibrium of each command.
    pub fn bends(
        &self,
        commands: &[Vec<f64>],
        gravity: Vec3,
        tip: Vec3,
        progress: &Progress,
    ) -> Result<Vec<Bend>> {
        let moduli = Moduli::new(&self.solid)?;
        let causes = LOADS + moduli.count() + self.solid.cables.len();
        self.room("the bends", &[commands.len()], causes * (causes + 1) / 2)?;
        self.toured(commands, gravity, tip, progress, |solver, state| {
            self.bend(solver, state, &moduli)
        })
    }

    fn bend(&self, solver: &mut Solver, state: &State, moduli: &Moduli) -> Result<Bend> {
        solver.linearise(state)?;
        let tension: Vec<f64> = solver.pulls(state).iter().map(|p| p.max(0.0)).collect();
        let work = &mut solver.work;
        let slopes: Vec<Vec<f64>> = (0..tension.len())
            .map(|c| work.slope(c, &state.x))
            .collect();
        let against = |force: &[f64]| force.iter().map(|f| -f).collect::<Vec<_>>();
        let dead = self.dead().map(|force| (force, None, None));
        let stiffer = (0..moduli.count()).map(|m| {
            let force = moduli.first(&self.solid, m, &state.x);
            (against(&force), Some(m), None)
        });
        let pulls = slopes.iter().enumerate();
        let pulls = pulls.map(|(c, b)| (against(b), None, Some(c)));
        let causes: Vec<Cause> = dead
            .chain(stiffer)
            .chain(pulls)
            .map(|(force, modulus, cable)| {
                let step = work.solve_slack(force);
                let longest = step.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
                let amount = REACH / longest.max(1e-9);
                Cause {
                    step,
                    modulus,
                    cable,
                    amount,
                }
            })
            .collect();
        let still = Difference::new(&self.solid, state, &tension);
        let alone: Vec<(Vec<f64>, Vec<f64>)> = causes.iter().map(|c| still.along(&[c])).collect();
        let at = self.points.place(&state.x);
        let mut answer = Bend {
            growth: vec![0.0; causes.len()],
            ..Bend::default()
        };
        let (mut lengths, shares) = (vec![], shares(&causes));
        for (k, one) in causes.iter().enumerate() {
            for (l, other) in causes.iter().enumerate().skip(k) {
                let both = if k == l {
                    alone[k].clone()
                } else {
                    let sum = still.along(&[one, other]);
                    mixed(sum, &alone[k], &alone[l])
                };
                let scale = 1.0 / (one.amount * other.amount);
                let mut force: Vec<f64> = both.0.iter().map(|r| -scale * r).collect();
                still.subtract_moduli(moduli, one, other, &mut force);
                let step = work.solve_slack(force);
                answer.growth[k] += shares[l] * inner(&other.step, &step);
                if k != l {
                    answer.growth[l] += shares[k] * inner(&one.step, &step);
                }
                let moved = self.solid.displace(&state.x, &step, 1.0);
                let moved = self.points.place(&moved);
                let field = moved.iter().zip(&at).map(|(p, q)| p - q);
                answer.fields.push(field.collect());
                let longer = slopes.iter().zip(&both.1);
                lengths.push(
                    longer
                        .map(|(b, own)| scale * own + inner(b, &step))
                        .collect::<Vec<_>>(),
                );
            }
        }
        for c in 0..tension.len() {
            answer.stretch.extend(lengths.iter().map(|pair| pair[c]));
        }
        Ok(answer)
    }
}

/// Weight of ⟨x_l, x_kl⟩ of each cause l in a growth.
fn shares(causes: &[Cause]) -> Vec<f64> {
    let stiffer = causes.iter().filter(|c| c.modulus.is_some()).count();
    let ends = [0, TIP_FORCE, LOADS, LOADS + stiffer, causes.len()];
    let kinds: Vec<&[Cause]> = ends.windows(2).map(|w| &causes[w[0]..w[1]]).collect();
    let counts = |kind: &&[Cause]| kind.iter().any(|c| c.modulus.is_none());
    let there = kinds.iter().copied().filter(counts).count() as f64;
    let share = |kind: &&[Cause]| {
        let size: f64 = kind.iter().map(|c| inner(&c.step, &c.step)).sum();
        let one = if counts(kind) { 1.0 } else { 0.0 };
        vec![one / (there * size.max(1e-12)); kind.len()]
    };
    kinds.iter().flat_map(share).collect()
}

/// ½ [q(k + l) − q(k) − q(l)] of forces and lengths.
fn mixed(
    sum: (Vec<f64>, Vec<f64>),
    one: &(Vec<f64>, Vec<f64>),
    other: &(Vec<f64>, Vec<f64>),
) -> (Vec<f64>, Vec<f64>) {
    let half = |s: Vec<f64>, a: &[f64], b: &[f64]| {
        let parts = s.iter().zip(a).zip(b);
        parts.map(|((s, a), b)| 0.5 * (s - a - b)).collect()
    };
    (half(sum.0, &one.0, &other.0), half(sum.1, &one.1, &other.1))
}

/// Second differences about one state.
struct Difference<'a> {
    solid: &'a Solid,
    state: &'a State,
    tension: &'a [f64],
    /// Forces on the unknowns and lengths there.
    here: (Vec<f64>, Vec<f64>),
}

impl<'a> Difference<'a> {
    fn new(solid: &'a Solid, state: &'a State, tension: &'a [f64]) -> Self {
        let mut new = Difference {
            solid,
            state,
            tension,
            here: (vec![], vec![]),
        };
        new.here = new.at(&state.x, tension);
        new
    }

    fn at(&self, x: &[Vec3], tension: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (mut force, mut stretch) = (vec![Vec3::ZERO; x.len()], vec![0.0; tension.len()]);
        let parts = (&self.solid.elements[..], &self.solid.cables[..]);
        add_parts(parts, x, tension, 1.0, &mut force, &mut stretch);
        (self.solid.gathered(force), stretch)
    }

    /// Subtract from `force` the contribution of moduli among two causes to D²r, per unit of both.
    fn subtract_moduli(&self, moduli: &Moduli, one: &Cause, other: &Cause, force: &mut [f64]) {
        let mut subtract = |times: f64, derivative: Vec<f64>| {
            let pairs = force.iter_mut().zip(derivative);
            pairs.for_each(|(f, d)| *f -= times * d);
        };
        for (modulus, along) in [(one.modulus, other), (other.modulus, one)] {
            for sign in [1.0, -1.0].into_iter().filter(|_| modulus.is_some()) {
                let x = self
                    .solid
                    .displace(&self.state.x, &along.step, sign * along.amount);
                let slope = modulus.map_or(vec![], |m| moduli.first(self.solid, m, &x));
                subtract(sign / (2.0 * along.amount), slope);
            }
        }
        if let (Some(i), Some(j)) = (one.modulus, other.modulus) {
            subtract(1.0, moduli.second(self.solid, i, j, &self.state.x));
        }
    }

    /// r(+d) + r(−d) − 2 r(0), and the same of the lengths, along REACH of some causes together.
    fn along(&self, causes: &[&Cause]) -> (Vec<f64>, Vec<f64>) {
        let mut sum = self.here.clone();
        sum.0.iter_mut().for_each(|r| *r *= -2.0);
        sum.1.iter_mut().for_each(|l| *l *= -2.0);
        for sign in [1.0, -1.0] {
            let (mut x, mut tension) = (self.state.x.clone(), self.tension.to_vec());
            for cause in causes {
                x = self.solid.displace(&x, &cause.step, sign * cause.amount);
                if let Some(c) = cause.cable {
                    tension[c] += sign * cause.amount;
                }
            }
            let (force, lengths) = self.at(&x, &tension);
            sum.0.iter_mut().zip(force).for_each(|(s, f)| *s += f);
            sum.1.iter_mut().zip(lengths).for_each(|(s, l)| *s += l);
        }
        sum
    }
}
