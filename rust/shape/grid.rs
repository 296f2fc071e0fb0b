//! A tensor grid of commands: its axes, and the stencils of its cubic pieces (`cubic.rs`).
//!
//! Nodes are counted with the last axis fastest. Outside, values continue linearly from the border
//! in each axis.

use crate::error::{Result, invalid};
use crate::memory::room;
use crate::shape::cubic::{Axis, NO_AXIS, Stencil};
use crate::shape::modes::accumulate;
use std::hash::{BuildHasher, Hash, Hasher, RandomState};
use std::sync::{Arc, LazyLock};

/// Most channels of a tensor grid; beyond, it has too many nodes.
pub const MAX_CHANNELS: usize = 3;

/// One stencil per axis.
pub type Stencils = [Stencil; MAX_CHANNELS];

/// Ascending axes.
#[derive(Debug, Clone)]
pub struct Grid {
    axes: Arc<[Axis]>,
    /// Hash of the axes for comparing grids (SipHash, 64 bits, with keys of this process, so a file
    /// cannot be made to collide with another).
    mark: u64,
}

/// The keys of `Grid::mark`.
static KEYS: LazyLock<RandomState> = LazyLock::new(RandomState::new);

/// Most cached grids per command.
const KEPT: usize = 4;

impl PartialEq for Grid {
    fn eq(&self, other: &Grid) -> bool {
        self.mark == other.mark
    }
}

/// The stencils of several grids at one command, cached by grid.
#[derive(Default)]
pub struct Nodes {
    marks: [u64; KEPT],
    carry: [Carry; KEPT],
    known: usize,
}

impl Nodes {
    /// Forget the command.
    pub fn clear(&mut self) {
        self.known = 0;
    }

    /// The stencil of a grid at the command `u`, which must not change until `clear`.
    pub fn of(&mut self, grid: &Grid, u: &[f64]) -> &Carry {
        let known = self.marks[..self.known]
            .iter()
            .position(|m| *m == grid.mark);
        if let Some(place) = known {
            return &self.carry[place];
        }
        let place = self.known.min(KEPT - 1);
        self.marks[place] = grid.mark;
        self.carry[place].find(grid, &grid.stencils(u, None));
        self.known = place + 1;
        &self.carry[place]
    }
}

impl Grid {
    /// From `axes` (ascending, ≥ 2 nodes each); no axes make one node.
    pub fn new(axes: Vec<Vec<f64>>) -> Result<Grid> {
        if axes.len() > MAX_CHANNELS {
            return Err(invalid(format!(
                "a table has at most {MAX_CHANNELS} axes, got {}; use another kind of prior for \
                more channels",
                axes.len()
            )));
        }
        for (c, axis) in axes.iter().enumerate() {
            if axis.len() < 2
                || axis.windows(2).any(|w| w[1] <= w[0])
                || axis.iter().any(|node| !node.is_finite())
            {
                return Err(invalid(format!(
                    "axis {c} of a table must rise strictly over at least 2 finite nodes, got {} \
                    nodes",
                    axis.len()
                )));
            }
        }
        let lengths: Vec<usize> = axes.iter().map(Vec::len).chain([1]).collect();
        room("a grid", &lengths)?;
        let mut hasher = KEYS.build_hasher();
        for axis in &axes {
            axis.len().hash(&mut hasher);
            axis.iter()
                .for_each(|node| node.to_bits().hash(&mut hasher));
        }
        Ok(Grid {
            axes: axes.into_iter().map(Axis::new).collect(),
            mark: hasher.finish(),
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

    /// The command of a node.
    pub fn node(&self, number: usize) -> Vec<f64> {
        let (mut u, mut rest) = (vec![0.0; self.channels()], number);
        for (u, axis) in u.iter_mut().zip(self.axes.iter()).rev() {
            *u = axis.nodes()[rest % axis.nodes().len()];
            rest /= axis.nodes().len();
        }
        u
    }

    /// The stencils at a command, or those of the slope over one channel.
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

/// Most nodes of a stencil, and values summed at a time: as many as fit in registers.
const MOST_NODES: usize = 64;
const AT_ONCE: usize = 8;

/// The nodes of a stencil, and the share of each.
pub struct Carry {
    nodes: [(usize, f64); MOST_NODES],
    count: usize,
}

impl Default for Carry {
    fn default() -> Carry {
        Carry {
            nodes: [(0, 0.0); MOST_NODES],
            count: 0,
        }
    }
}

impl Carry {
    /// Those of one stencil per axis.
    #[inline(always)]
    pub fn new(grid: &Grid, stencils: &Stencils) -> Carry {
        let mut carry = Carry::default();
        carry.find(grid, stencils);
        carry
    }

    #[inline(always)]
    fn find(&mut self, grid: &Grid, stencils: &Stencils) {
        self.count = 0;
        grid.visit(
            stencils,
            #[inline(always)]
            |node, share| {
                self.nodes[self.count] = (node, share);
                self.count += 1;
            },
        );
    }

    /// Each node with its share.
    pub fn nodes(&self) -> &[(usize, f64)] {
        &self.nodes[..self.count]
    }

    /// Add `times` the nodes' rows of `numbers` by their shares to `sum`.
    #[inline(always)]
    pub fn blend(&self, numbers: &[f64], times: f64, sum: &mut [f64]) {
        let width = sum.len();
        let whole = width - width % AT_ONCE;
        for first in (0..whole).step_by(AT_ONCE) {
            let mut part = [0.0; AT_ONCE];
            part.copy_from_slice(&sum[first..first + AT_ONCE]);
            for (node, share) in self.nodes() {
                let start = node * width + first;
                accumulate(&mut part, &numbers[start..start + AT_ONCE], times * share);
            }
            sum[first..first + AT_ONCE].copy_from_slice(&part);
        }
        for (node, share) in self.nodes() {
            let row = &numbers[node * width + whole..(node + 1) * width];
            accumulate(&mut sum[whole..], row, times * share);
        }
    }
}
