//! A tensor grid of commands: its axes, and which of its nodes carry a value between them, by cubic pieces (`cubic.rs`).
//!
//! Nodes are counted with the last axis fastest. Outside, values go on linearly from the border in each axis.

use crate::cubic::{Axis, NO_AXIS, Stencil};
use crate::error::{Result, invalid};
use crate::room::room;

/// The most channels a tensor grid can have; beyond, the number of nodes explodes.
pub const MAX_CHANNELS: usize = 3;

/// One stencil an axis.
pub type Stencils = [Stencil; MAX_CHANNELS];

/// Rising axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    axes: Vec<Axis>,
}

impl Grid {
    /// Take `axes` (rising, ≥ 2 nodes each); none at all make one node.
    pub fn new(axes: Vec<Vec<f64>>) -> Result<Grid> {
        if axes.len() > MAX_CHANNELS {
            return Err(invalid(format!(
                "a table has at most {MAX_CHANNELS} axes, got {}; use another kind of prior for more channels",
                axes.len()
            )));
        }
        for (c, axis) in axes.iter().enumerate() {
            if axis.len() < 2
                || axis.windows(2).any(|w| w[1] <= w[0])
                || axis.iter().any(|node| !node.is_finite())
            {
                return Err(invalid(format!(
                    "axis {c} of a table must rise strictly over at least 2 finite nodes, got {} nodes",
                    axis.len()
                )));
            }
        }
        let lengths: Vec<usize> = axes.iter().map(Vec::len).chain([1]).collect();
        room("a grid", &lengths)?;
        Ok(Grid {
            axes: axes.into_iter().map(Axis::new).collect(),
        })
    }

    /// Number of axes.
    pub fn channels(&self) -> usize {
        self.axes.len()
    }

    /// The nodes of each axis.
    pub fn axes(&self) -> impl Iterator<Item = &[f64]> {
        self.axes.iter().map(Axis::nodes)
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.axes().map(<[f64]>::len).product()
    }

    /// The stencils at a command, or those of the slope by one of its channels.
    pub fn stencils(&self, u: &[f64], derivative: Option<usize>) -> Stencils {
        let mut stencils = [NO_AXIS; MAX_CHANNELS];
        for (c, axis) in self.axes.iter().enumerate() {
            stencils[c] = axis.stencil(u[c], derivative == Some(c));
        }
        stencils
    }

    /// Call `add(node, share)` for the nodes of one stencil per axis.
    #[inline(always)]
    pub fn visit(&self, stencils: &Stencils, mut add: impl FnMut(usize, f64)) {
        let length = |c: usize| self.axes.get(c).map_or(1, |axis| axis.nodes().len());
        let [a, b, c] = stencils;
        for i in 0..a.count {
            for j in 0..b.count {
                let row = ((a.first + i) * length(1) + b.first + j) * length(2) + c.first;
                for k in 0..c.count {
                    add(row + k, a.weights[i] * b.weights[j] * c.weights[k]);
                }
            }
        }
    }
}
