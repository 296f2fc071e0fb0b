//! A shape family from scattered commands: a few modes, each a sum of radial basis functions and a
//! linear tail.
//!
//! `shape(u) = mean + Σ_m a_m(u)·mode_m`, `a_m(u) = b_m + Σ_c t_mc·q_c + Σ_i w_mi·φ(|q − q_i|)`,
//! with q = u/scale by channel, nodes q_i, and the polyharmonic kernel φ(r) = r or r³ (J. Duchon,
//! "Splines minimizing rotation-invariant semi-norms in Sobolev spaces", 1977,
//! doi:10.1007/BFb0086566). r keeps the kinks of tendons that become slack, r³ is C². If the
//! weights annihilate linear functions, as those of a fit do, the family grows linearly far out,
//! without clamping. Units: commands in, the fitted quantity out. The fit, its smoothing and its
//! held-out error are in `softmap_edge/sweep/scattered.py`. Cost: nodes × (channels + modes) per
//! command. Pinned by the tests below.

use crate::error::{Result, invalid};
use crate::memory::with_few;
use crate::shape::Shape;
use crate::shape::modes::{Modes, accumulate};

/// Least scale, in command units: a division by it must stay finite.
const SMALLEST_SCALE: f64 = 1e-9;

/// The kernel of a scattered family.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// φ(r) = r
    Linear,
    /// φ(r) = r³
    Cubic,
}

impl Kernel {
    /// By its power, 1 or 3.
    pub fn of_power(power: usize) -> Result<Kernel> {
        match power {
            1 => Ok(Kernel::Linear),
            3 => Ok(Kernel::Cubic),
            _ => Err(invalid(format!(
                "a scattered family has a kernel of power 1 or 3, got {power}"
            ))),
        }
    }

    fn value(self, r: f64) -> f64 {
        match self {
            Kernel::Linear => r,
            Kernel::Cubic => r * r * r,
        }
    }

    /// φ'(r)/r, and 0 at the tip of the cone φ = r, where the slope is undefined.
    fn slope_over_r(self, r: f64) -> f64 {
        match self {
            Kernel::Linear if r > 0.0 => 1.0 / r,
            Kernel::Linear => 0.0,
            Kernel::Cubic => 3.0 * r,
        }
    }
}

/// Modes over scattered commands.
#[derive(Debug, Clone)]
pub struct Scattered {
    scale: Vec<f64>,
    /// Nodes q_i (S, C), in multiples of the scale.
    nodes: Vec<f64>,
    kernel: Kernel,
    /// (S + 1 + C, m): a row for each node, the constant, a row for each channel.
    coefficients: Vec<f64>,
    modes: Modes,
}

impl Scattered {
    /// Build from `nodes` (S, C) and `scale` (C,) in command units, `kernel`, `coefficients` (S + 1
    /// + C, m), `mean` (M,) and `modes` (m, M), all row-major.
    pub fn new(
        nodes: Vec<f64>,
        scale: Vec<f64>,
        kernel: Kernel,
        coefficients: Vec<f64>,
        mean: Vec<f64>,
        modes: Vec<f64>,
    ) -> Result<Scattered> {
        let channels = scale.len();
        if channels == 0 || !nodes.len().is_multiple_of(channels) {
            return Err(invalid(format!(
                "a scattered family needs nodes (S, C) and a scale (C,) of at least one channel, \
                got {} and {channels} numbers",
                nodes.len()
            )));
        }
        let modes = Modes::new(mean, modes)?;
        let rows = nodes.len() / channels + 1 + channels;
        if Some(coefficients.len()) != rows.checked_mul(modes.count()) {
            return Err(invalid(format!(
                "coefficients must be ({rows} rows: nodes, constant, channels; {} modes), got {} \
                numbers",
                modes.count(),
                coefficients.len()
            )));
        }
        if let Some(c) = scale.iter().position(|s| s.is_nan() || *s < SMALLEST_SCALE) {
            return Err(invalid(format!(
                "the scale of channel {c} of a scattered family is {}, expected at least \
                {SMALLEST_SCALE:e}",
                scale[c]
            )));
        }
        let nodes: Vec<f64> = nodes
            .chunks_exact(channels)
            .flat_map(|node| node.iter().zip(&scale).map(|(u, s)| u / s))
            .collect();
        let everything = nodes.iter().chain(&scale).chain(&coefficients);
        let everything = everything.chain(modes.mean()).chain(modes.rows());
        if everything.into_iter().any(|value| !value.is_finite()) {
            return Err(invalid(
                "a scattered family holds a number that is not finite; rebuild it from a clean \
                sweep",
            ));
        }
        Ok(Scattered {
            scale,
            nodes,
            kernel,
            coefficients,
            modes,
        })
    }

    /// The same family seen through a linear map: `shape(u)·weights + offset`, `weights` (M, M2),
    /// `offset` (M2,).
    pub fn project(&self, weights: &[f64], offset: &[f64]) -> Result<Scattered> {
        Ok(Scattered {
            modes: self.modes.project(weights, offset)?,
            ..self.clone()
        })
    }

    /// The number of outputs M, which a projection starts from.
    pub fn outputs(&self) -> usize {
        self.modes.size()
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.coefficients[i * self.modes.count()..(i + 1) * self.modes.count()]
    }

    /// Call `add(node, r, q − q_node)` for every node.
    fn visit(&self, u: &[f64], mut add: impl FnMut(usize, f64, &[f64])) {
        with_few(2 * u.len(), |work| {
            let (q, apart) = work.split_at_mut(u.len());
            let both = u.iter().zip(&self.scale);
            q.iter_mut().zip(both).for_each(|(q, (u, s))| *q = u / s);
            for (i, node) in self.nodes.chunks_exact(q.len()).enumerate() {
                let mut square = 0.0;
                for c in 0..q.len() {
                    apart[c] = q[c] - node[c];
                    square += apart[c] * apart[c];
                }
                add(i, square.sqrt(), apart);
            }
        });
    }
}

impl Shape for Scattered {
    fn channels(&self) -> usize {
        self.scale.len()
    }

    fn size(&self) -> usize {
        self.modes.size()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let tail = self.nodes.len() / self.scale.len();
        self.modes.eval(out, |weights| {
            accumulate(weights, self.row(tail), 1.0);
            for (c, s) in self.scale.iter().enumerate() {
                accumulate(weights, self.row(tail + 1 + c), u[c] / s);
            }
            self.visit(u, |i, r, _| {
                accumulate(weights, self.row(i), self.kernel.value(r))
            });
        });
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let tail = self.nodes.len() / self.scale.len();
        self.modes.jacobian(self.channels(), out, |c, weights| {
            accumulate(weights, self.row(tail + 1 + c), 1.0 / self.scale[c]);
            self.visit(u, |i, r, apart| {
                let slope = self.kernel.slope_over_r(r) * apart[c] / self.scale[c];
                accumulate(weights, self.row(i), slope);
            });
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Three nodes whose weights annihilate linear functions (1, −2, 1 on a line), two modes over
    /// three outputs.
    fn family(kernel: Kernel) -> Scattered {
        let nodes = vec![-4.0, -2.0, 0.0, 0.0, 4.0, 2.0];
        let coefficients = vec![
            1.0, -0.5, -2.0, 1.0, 1.0, -0.5, // nodes
            0.3, 0.1, 2.0, -1.0, 0.5, 4.0, // constant and tail
        ];
        let modes = vec![1.0, 0.0, 2.0, 0.0, -1.0, 1.0];
        Scattered::new(
            nodes,
            vec![4.0, 8.0],
            kernel,
            coefficients,
            vec![10.0, 20.0, 30.0],
            modes,
        )
        .unwrap()
    }

    fn value(shape: &impl Shape, u: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; shape.size()];
        shape.eval(u, &mut out);
        out
    }

    proptest! {
        #[test]
        fn slopes_match_differences_and_projection_is_linear(x in -9.0..9.0f64, y in -9.0..9.0f64) {
            let weights = [1.0, 0.5, -2.0, 0.0, 0.25, 3.0];
            for kernel in [Kernel::Linear, Kernel::Cubic] {
                let shape = family(kernel);
                let (mut slopes, h) = ([0.0; 6], 1e-5);
                shape.jacobian(&[x, y], &mut slopes);
                for (c, step) in [[h, 0.0], [0.0, h]].iter().enumerate() {
                    let plus = value(&shape, &[x + step[0], y + step[1]]);
                    let minus = value(&shape, &[x - step[0], y - step[1]]);
                    for m in 0..3 {
                        // The curvature of r is 1/r: a difference of step h next to a node sees h/r
                        // of it.
                        let near = [[-4.0, -2.0], [0.0, 0.0], [4.0, 2.0]]
                            .iter()
                            .map(|n| (x - n[0]).hypot(y - n[1]))
                            .fold(f64::MAX, f64::min);
                        let difference = (plus[m] - minus[m]) / (2.0 * h);
                        prop_assert!(near < 1e-2 || (difference - slopes[m * 2 + c]).abs() < 1e-6);
                    }
                }
                let (all, seen) = (value(&shape, &[x, y]), value(&shape.project(&weights, &[1.0, 2.0]).unwrap(), &[x, y]));
                for k in 0..2 {
                    let wanted: f64 = (0..3).map(|m| all[m] * weights[m * 2 + k]).sum::<f64>() + 1.0 + k as f64;
                    prop_assert!((seen[k] - wanted).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn at_a_node_the_slope_is_finite_and_the_value_is_the_formula() {
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let mut slopes = [0.0; 6];
            family(kernel).jacobian(&[0.0, 0.0], &mut slopes);
            assert!(slopes.iter().all(|s| s.is_finite()));
            // |q_1 − q_2| = |(1, 0.25)|
            let phi = kernel.value(1.0f64.hypot(0.25));
            let weight = [0.3 + 2.0 * phi, 0.1 - phi];
            let wanted = [
                10.0 + weight[0],
                20.0 - weight[1],
                30.0 + 2.0 * weight[0] + weight[1],
            ];
            let found = value(&family(kernel), &[0.0, 0.0]);
            assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12));
        }
    }

    #[test]
    fn far_out_it_goes_on_linearly() {
        let at = |s: f64| value(&family(Kernel::Cubic), &[s, 0.3 * s])[0];
        let (a, b, c) = (at(1e3), at(2e3), at(3e3));
        assert!(
            (c - 2.0 * b + a).abs() < 1e-3 * (b - a).abs(),
            "{a} {b} {c}"
        );
    }

    #[test]
    fn what_does_not_fit_is_refused_in_one_line() {
        let make = |nodes: usize, scale: f64, coefficients: usize| {
            Scattered::new(
                vec![0.0; nodes],
                vec![scale; 2],
                Kernel::Cubic,
                vec![0.0; coefficients],
                vec![0.0; 3],
                vec![0.0; 6],
            )
        };
        assert!(make(6, 1.0, 12).is_ok());
        for (nodes, scale, coefficients) in [
            (5, 1.0, 12),
            (6, 0.0, 12),
            (6, f64::NAN, 12),
            (6, 1.0, 11),
            (6, 1e-320, 12),
        ] {
            let message = make(nodes, scale, coefficients).unwrap_err().to_string();
            assert!(!message.contains('\n'), "{message}");
        }
        assert!(Kernel::of_power(2).is_err());
    }
}
