//! Cubic interpolation along one axis with uniform or non-uniform nodes: stencils and weights.
//!
//! Hermite pieces whose node slopes come from the parabola through three neighbouring nodes
//! (one-sided at the borders). On uniform spacing this is cubic convolution (R. Keys, "Cubic
//! convolution interpolation for digital image processing", 1981, doi:10.1109/TASSP.1981.1163711),
//! which requires uniform spacing. C1, exact for quadratics, error O(h³); beyond the ends the value
//! continues along the border's slope. Pinned by the tests of `table.rs` and the one below.

/// The nodes that one axis contributes at one command: first node, how many, and their weights.
#[derive(Clone, Copy)]
pub struct Stencil {
    pub first: usize,
    pub count: usize,
    pub weights: [f64; 4],
}

/// The stencil of a missing axis.
pub const NO_AXIS: Stencil = Stencil {
    first: 0,
    count: 1,
    weights: [1.0, 0.0, 0.0, 0.0],
};

/// The nodes of one axis, ascending, and the weights of their slopes.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    nodes: Vec<f64>,
    slopes: Vec<(usize, [f64; 3])>,
    /// Cells per mm of command, if uniform.
    density: f64,
    pieces: Vec<Piece>,
}

/// One cell: its stencil, and the weights as cubics of the share of its width.
#[derive(Debug, Clone, PartialEq)]
struct Piece {
    first: usize,
    count: usize,
    start: f64,
    inverse: f64,
    powers: [[f64; 4]; 4],
}

impl Axis {
    /// From at least two ascending nodes.
    pub fn new(nodes: Vec<f64>) -> Axis {
        let slopes = (0..nodes.len()).map(|i| node_slope(&nodes, i)).collect();
        let last = nodes.len() - 1;
        let mut axis = Axis {
            density: last as f64 / (nodes[last] - nodes[0]),
            pieces: vec![],
            nodes,
            slopes,
        };
        axis.pieces = (0..last).map(|cell| axis.piece(cell)).collect();
        axis
    }

    /// The cubics of a cell: Hermite's, with the slopes at its ends as sums of nodes.
    fn piece(&self, cell: usize) -> Piece {
        let axis = &self.nodes;
        let width = axis[cell + 1] - axis[cell];
        let first = cell.saturating_sub(1);
        let mut powers = [[0.0; 4]; 4];
        for (power, hermite) in powers.iter_mut().zip([
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, width, 0.0],
            [-3.0, 3.0, -2.0 * width, -width],
            [2.0, -2.0, width, width],
        ]) {
            *power = self.spread(cell, hermite);
        }
        Piece {
            first,
            count: (cell + 3).min(axis.len()) - first,
            start: axis[cell],
            inverse: 1.0 / width,
            powers,
        }
    }

    /// Weights of the nodes of a cell for weights of the values at its ends and of the slopes
    /// there.
    fn spread(&self, cell: usize, hermite: [f64; 4]) -> [f64; 4] {
        let first = cell.saturating_sub(1);
        let mut weights = [0.0; 4];
        weights[cell - first] += hermite[0];
        weights[cell + 1 - first] += hermite[1];
        for (node, weight) in [(cell, hermite[2]), (cell + 1, hermite[3])] {
            let (start, slopes) = &self.slopes[node];
            for (i, value) in slopes.iter().enumerate().take(self.nodes.len().min(3)) {
                weights[start + i - first] += weight * value;
            }
        }
        weights
    }

    /// The nodes.
    pub fn nodes(&self) -> &[f64] {
        &self.nodes
    }

    /// The cell that contains `u`, or the border cell beyond the ends; for uniform nodes, it is the
    /// first one tested.
    fn cell(&self, u: f64) -> usize {
        let (axis, last) = (&self.nodes, self.nodes.len() - 2);
        let mut cell = (((u - axis[0]) * self.density) as usize).min(last);
        while cell > 0 && axis[cell] > u {
            cell -= 1;
        }
        while cell < last && axis[cell + 1] <= u {
            cell += 1;
        }
        cell
    }

    /// Weights of the (at most four) nodes of the stencil at `u`, for the value or its derivative.
    pub fn stencil(&self, u: f64, derivative: bool) -> Stencil {
        let axis = &self.nodes;
        let last = axis.len() - 1;
        let cell = self.cell(u);
        let piece = &self.pieces[cell];
        if !derivative && (axis[0]..=axis[last]).contains(&u) {
            let s = (u - piece.start) * piece.inverse;
            let [a, b, c, d] = &piece.powers;
            return Stencil {
                first: piece.first,
                count: piece.count,
                weights: std::array::from_fn(|i| a[i] + s * (b[i] + s * (c[i] + s * d[i]))),
            };
        }
        let width = axis[cell + 1] - axis[cell];
        let inside = u.clamp(axis[0], axis[last]);
        let s = (inside - axis[cell]) / width;
        let value = [
            (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s),
            s * s * (3.0 - 2.0 * s),
            width * s * (1.0 - s) * (1.0 - s),
            -width * s * s * (1.0 - s),
        ];
        let slope = || {
            [
                6.0 * s * (s - 1.0) / width,
                -6.0 * s * (s - 1.0) / width,
                (1.0 - s) * (1.0 - 3.0 * s),
                s * (3.0 * s - 2.0),
            ]
        };
        let mut hermite = if derivative { slope() } else { value };
        if !derivative && inside != u {
            hermite
                .iter_mut()
                .zip(slope())
                .for_each(|(value, slope)| *value += slope * (u - inside));
        }
        Stencil {
            first: piece.first,
            count: piece.count,
            weights: self.spread(cell, hermite),
        }
    }
}

/// Slope at a node of the parabola through it and its neighbours, as weights of nodes `start..start
/// + 3`.
fn node_slope(axis: &[f64], node: usize) -> (usize, [f64; 3]) {
    if axis.len() == 2 {
        let width = axis[1] - axis[0];
        return (0, [-1.0 / width, 1.0 / width, 0.0]);
    }
    let start = node.saturating_sub(1).min(axis.len() - 3);
    let (a, b) = (
        axis[start + 1] - axis[start],
        axis[start + 2] - axis[start + 1],
    );
    let weights = match node - start {
        0 => [
            -(2.0 * a + b) / (a * (a + b)),
            (a + b) / (a * b),
            -a / (b * (a + b)),
        ],
        1 => [-b / (a * (a + b)), (b - a) / (a * b), a / (b * (a + b))],
        _ => [
            b / (a * (a + b)),
            -(a + b) / (a * b),
            (a + 2.0 * b) / (b * (a + b)),
        ],
    };
    (start, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_those_of_slopes_to_zero_at_nodes_between_and_beyond() {
        let axis = Axis::new(vec![-2.0, -1.5, 0.0, 4.0]);
        for u in [-9.0, -2.0, -1.6, -1.5, 0.0, 3.9, 4.0, 11.0] {
            let total = |derivative| axis.stencil(u, derivative).weights.iter().sum::<f64>();
            assert!((total(false) - 1.0).abs() < 1e-12 && total(true).abs() < 1e-12);
            let slope = axis.stencil(u, true);
            let linear: f64 = (0..slope.count)
                .map(|i| slope.weights[i] * axis.nodes()[slope.first + i])
                .sum();
            assert!((linear - 1.0).abs() < 1e-12);
        }
    }
}
