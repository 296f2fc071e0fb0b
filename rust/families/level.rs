//! Level 1 of the diagnosis: ridge regression of a residual on the columns of families, with
//! blocked cross-validation.
//!
//! Columns are added by name; `close` takes the residual. Every fit after that is a small solve: θ
//! = (G + Λ)⁻¹ b from the training frames of a fold, and the held-out loss |y − Xθ|² from the Gram
//! of its test frames. Λ holds the ridge of each name plus 1e-9 of the mean diagonal, which makes
//! collinear columns solvable. A Gram matrix is made of blocks, one for two names (`gram.rs`). A
//! block is made when a fit first needs it and kept, so families that are never fitted together, or
//! never in folds, cost nothing. Without whitening, the Gram of training frames is that of all
//! frames less that of the few others. Checked by tests/noise/test_level.py.

use super::gram::{Columns, Frames, whitened};
use crate::error::{Result, invalid};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// Share of the mean diagonal that is added to it: makes collinear columns solvable.
const JITTER: f64 = 1e-9;
/// Number of the block of the residual.
const RESIDUAL: usize = 0;

/// A set of frames with the basis (frames, r) and strength (r,) of its kernel, not yet checked.
pub struct FrameSet {
    pub index: Vec<usize>,
    pub basis: Vec<f64>,
    pub strength: Vec<f64>,
}

/// Columns of one name, sorted by base.
struct Block {
    name: String,
    /// Distinct bases (M, K), shared between blocks.
    bases: Vec<Arc<Vec<f64>>>,
    /// Base and weight (K,) of each column.
    base: Vec<usize>,
    weight: Vec<Vec<f64>>,
    /// Position of each column as it was added.
    place: Vec<usize>,
    /// Number of frames K.
    frames: usize,
}

impl Block {
    fn columns(&self) -> Columns<'_> {
        Columns {
            bases: &self.bases,
            base: &self.base,
            weight: &self.weight,
            total: self.frames,
        }
    }
}

/// The frames of a problem in folds, which many levels share.
struct Folds {
    form: Vec<f64>,
    all: Frames,
    each: Vec<Fold>,
}

/// A fold: frames for training, frames for the test, and all frames that are not for training.
struct Fold {
    train: Frames,
    test: Frames,
    others: Vec<usize>,
}

/// Blocks of whitened Gram matrices over a set of frames, by the numbers of two names, the larger
/// one first.
#[derive(Default)]
struct Grams {
    along: HashMap<usize, Mat<f64>>,
    blocks: HashMap<(usize, usize), Mat<f64>>,
}

/// Columns by name, and what is known of their normal equations.
pub struct Level {
    folds: Arc<Folds>,
    frames: usize,
    /// The residual, then one for each name.
    blocks: Vec<Block>,
    closed: bool,
    /// Grams of all frames without whitening.
    plain: HashMap<(usize, usize), Mat<f64>>,
    all: Grams,
    /// Training and test frames of each fold.
    each: Vec<(Grams, Grams)>,
}

impl Level {
    /// Create a level from the model-error variance (M,) of each mode, the set of all frames, and
    /// (train, test) of each fold.
    pub fn new(form: Vec<f64>, all: FrameSet, folds: Vec<(FrameSet, FrameSet)>) -> Result<Level> {
        if form.is_empty() || form.iter().any(|s| s.is_nan() || *s < 0.0) {
            return Err(invalid(format!(
                "form is {form:?}; it must hold at least one variance, and none may be negative"
            )));
        }
        let frames = all.index.len();
        if frames == 0 || folds.is_empty() {
            return Err(invalid(format!(
                "{frames} frames and {} folds; level 1 needs at least one of each",
                folds.len()
            )));
        }
        let set = |name: String, given: FrameSet| {
            Frames::new(&name, given.index, &given.basis, &given.strength, frames)
        };
        let fold = |(f, (train, test)): (usize, (FrameSet, FrameSet))| {
            let train = set(format!("fold {f}, train"), train)?;
            let mut trains = vec![false; frames];
            train.index.iter().for_each(|k| trains[*k] = true);
            Ok(Fold {
                test: set(format!("fold {f}, test"), test)?,
                others: (0..frames).filter(|k| !trains[*k]).collect(),
                train,
            })
        };
        let folds = Folds {
            all: set("all frames".into(), all)?,
            each: folds
                .into_iter()
                .enumerate()
                .map(fold)
                .collect::<Result<_>>()?,
            form,
        };
        Ok(Level::on(Arc::new(folds), frames))
    }

    /// The same folds without columns.
    pub fn fresh(&self) -> Level {
        Level::on(self.folds.clone(), self.frames)
    }

    fn on(folds: Arc<Folds>, frames: usize) -> Level {
        let each = folds.each.iter().map(|_| Default::default()).collect();
        let residual = Block {
            name: String::new(),
            bases: vec![],
            base: vec![0],
            weight: vec![vec![1.0; frames]],
            place: vec![0],
            frames,
        };
        Level {
            folds,
            frames,
            blocks: vec![residual],
            closed: false,
            plain: HashMap::new(),
            all: Grams::default(),
            each,
        }
    }

    /// Number of modes M.
    pub fn modes(&self) -> usize {
        self.folds.form.len()
    }

    /// Number of frames K.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Names in the order in which they were added.
    pub fn names(&self) -> Vec<&str> {
        self.blocks[1..].iter().map(|block| &*block.name).collect()
    }

    /// Add columns X_j = base[which_j] ∘ weight_j under a name: `base` (s, K, M), `which` (n,),
    /// `weight` (n, K).
    pub fn add(&mut self, name: &str, base: &[f64], which: &[usize], weight: &[f64]) -> Result<()> {
        if self.names().contains(&name) {
            return Err(invalid(format!(
                "columns {name:?} already exist; use another name"
            )));
        }
        let size = self.frames * self.modes();
        if !base.len().is_multiple_of(size) || weight.len() != which.len() * self.frames {
            return Err(invalid(format!(
                "{name}: base has {} numbers and weight has {}, expected (s, {}, {}) and ({}, {2})",
                base.len(),
                weight.len(),
                self.frames,
                self.modes(),
                which.len(),
            )));
        }
        let count = base.len() / size;
        if let Some(bad) = which.iter().find(|which| **which >= count) {
            return Err(invalid(format!(
                "{name}: which contains {bad}, but there are only {count} bases"
            )));
        }
        let bases = base.chunks_exact(size).map(|base| self.shared(base));
        let bases = bases.collect();
        let mut order: Vec<usize> = (0..which.len()).collect();
        order.sort_by_key(|j| which[*j]);
        let row = |j: &usize| weight[j * self.frames..(j + 1) * self.frames].to_vec();
        self.blocks.push(Block {
            name: name.into(),
            bases,
            base: order.iter().map(|j| which[*j]).collect(),
            weight: order.iter().map(row).collect(),
            place: order,
            frames: self.frames,
        });
        Ok(())
    }

    /// A base (K, M) by modes. Families share the slopes, so equal bases are stored once.
    fn shared(&self, base: &[f64]) -> Arc<Vec<f64>> {
        let by_modes = transposed(base, self.frames, self.modes());
        let known = self.blocks.iter().flat_map(|block| &block.bases);
        let known = known.into_iter().find(|known| ***known == by_modes);
        known.cloned().unwrap_or_else(|| Arc::new(by_modes))
    }

    /// Take the residual (K, M), whose modes are in units of noise.
    pub fn close(&mut self, residual: &[f64]) -> Result<()> {
        self.modes_of("residual", residual)?;
        let residual = transposed(residual, self.frames, self.modes());
        self.blocks[RESIDUAL].bases = vec![Arc::new(residual)];
        self.closed = true;
        self.plain.retain(|(_, b), _| *b != RESIDUAL);
        let parts = self.each.iter_mut().flat_map(|(train, test)| [train, test]);
        for grams in parts.chain([&mut self.all]) {
            grams.along.remove(&RESIDUAL);
            grams.blocks.retain(|(_, b), _| *b != RESIDUAL);
        }
        Ok(())
    }

    /// Held-out loss (F,) of each fold, fitting the columns of `names` with one ridge each. Without
    /// names: loss of the residual.
    pub fn losses(&mut self, names: &[String], ridges: &[f64]) -> Result<Vec<f64>> {
        let selection = self.selection(names, ridges)?;
        self.prepare(&selection);
        let (blocks, plain, form) = (&self.blocks, &self.plain, &self.folds.form);
        let loss = |((train, test), fold): (&mut (Grams, Grams), &Fold)| {
            for pair in selection.pairs() {
                train.ensure(blocks, &fold.train, form, pair, |a, b| {
                    &plain[&pair] - a.plain(b, &fold.others)
                });
                test.ensure(blocks, &fold.test, form, pair, |a, b| {
                    a.plain(b, &fold.test.index)
                });
            }
            let theta = selection.solve(train)?;
            let (system, right) = (selection.system(test), selection.right(test));
            let mut loss = test.blocks[&(RESIDUAL, RESIDUAL)][(0, 0)];
            for (i, theta_i) in theta.iter().enumerate() {
                let others = theta[..i].iter().enumerate();
                let crossed: f64 = others.map(|(j, theta)| theta * system[(i, j)]).sum();
                let own = 0.5 * theta_i * system[(i, i)] + crossed - right[(i, 0)];
                loss += 2.0 * theta_i * own;
            }
            Ok(loss)
        };
        let folds = self.each.par_iter_mut().zip(&self.folds.each);
        folds.map(loss).collect()
    }

    /// Loss of a fit of all frames on these same frames.
    pub fn training_loss(&mut self, names: &[String], ridges: &[f64]) -> Result<f64> {
        let selection = self.fit(names, ridges)?;
        let ((factor, added), right) = (selection.factor(&self.all)?, selection.right(&self.all));
        let mut theta = right.clone();
        factor.solve_in_place(theta.as_mut());
        let (theta, right) = (theta.col_as_slice(0), right.col_as_slice(0));
        let explained: f64 = theta.iter().zip(right).map(|(t, b)| t * b).sum();
        let ridge: f64 = theta.iter().zip(&added).map(|(t, r)| t * t * r).sum();
        // |y − Xθ|² = y² − θᵀb − θᵀΛθ where (G + Λ)θ = b.
        Ok(self.all.blocks[&(RESIDUAL, RESIDUAL)][(0, 0)] - explained - ridge)
    }

    /// Fit all frames; return the column weights of each of `names`.
    pub fn theta(&mut self, names: &[String], ridges: &[f64]) -> Result<Vec<Vec<f64>>> {
        let selection = self.fit(names, ridges)?;
        let theta = selection.solve(&self.all)?;
        let mut rest = theta.as_slice();
        let parts = selection.blocks.iter().map(|block| {
            let place = &self.blocks[*block].place;
            let (mine, others) = rest.split_at(place.len());
            rest = others;
            let mut out = vec![0.0; place.len()];
            place
                .iter()
                .zip(mine)
                .for_each(|(at, value)| out[*at] = *value);
            out
        });
        Ok(parts.collect())
    }

    /// Effective degrees of freedom of `name` in a fit of all `names`: the trace of its block of (G
    /// + Λ)⁻¹ G.
    pub fn freedom(&mut self, names: &[String], ridges: &[f64], name: &str) -> Result<f64> {
        let selection = self.fit(names, ridges)?;
        let Some(which) = names.iter().position(|other| other == name) else {
            return Err(invalid(format!(
                "{name:?} is not one of the fitted names {names:?}"
            )));
        };
        let first: usize = selection.counts[..which].iter().sum();
        let count = selection.counts[which];
        let (factor, added) = selection.factor(&self.all)?;
        let mut inverse: Mat<f64> = Mat::zeros(added.len(), count);
        for j in 0..count {
            inverse[(first + j, j)] = 1.0;
        }
        factor.solve_in_place(inverse.as_mut());
        let held = (0..count).map(|j| added[first + j] * inverse[(first + j, j)]);
        Ok(count as f64 - held.sum::<f64>())
    }

    /// Modes (K, M) of the columns of a name with weights `theta` (n,), not whitened.
    pub fn fitted(&self, name: &str, theta: &[f64]) -> Result<Vec<f64>> {
        let block = &self.blocks[self.block(name)?];
        if theta.len() != block.place.len() {
            return Err(invalid(format!(
                "theta has {} weights, but {name:?} has {} columns",
                theta.len(),
                block.place.len()
            )));
        }
        let mut by_modes = vec![0.0; self.frames * self.modes()];
        for ((place, base), weight) in block.place.iter().zip(&block.base).zip(&block.weight) {
            let rows = by_modes.chunks_exact_mut(self.frames);
            for (out, base) in rows.zip(block.bases[*base].chunks_exact(self.frames)) {
                for ((out, base), weight) in out.iter_mut().zip(base).zip(weight) {
                    *out += theta[*place] * base * weight;
                }
            }
        }
        Ok(transposed(&by_modes, self.modes(), self.frames))
    }

    /// Loss (F,) of fixed modes (K, M) on the test frames of each fold, without any fit.
    pub fn losses_of(&self, modes: &[f64]) -> Result<Vec<f64>> {
        let mut alone = self.fresh();
        alone.close(modes)?;
        alone.losses(&[], &[])
    }

    fn modes_of(&self, name: &str, modes: &[f64]) -> Result<()> {
        if modes.len() == self.frames * self.modes() {
            return Ok(());
        }
        Err(invalid(format!(
            "{name} has {} numbers, expected ({}, {})",
            modes.len(),
            self.frames,
            self.modes()
        )))
    }

    fn block(&self, name: &str) -> Result<usize> {
        let found = self.blocks[1..].iter().position(|block| block.name == name);
        found.map(|place| place + 1).ok_or_else(|| {
            invalid(format!(
                "unknown columns {name:?}; available: {}",
                self.names().join(", ")
            ))
        })
    }

    /// What is fitted together, checked.
    fn selection(&self, names: &[String], ridges: &[f64]) -> Result<Selection> {
        if !self.closed {
            return Err(invalid(
                "there is no residual to fit; call close(residual) first",
            ));
        }
        if names.len() != ridges.len() {
            return Err(invalid(format!(
                "{} names and {} ridges; give one ridge per name",
                names.len(),
                ridges.len()
            )));
        }
        let mut selection = Selection::default();
        for (i, (name, ridge)) in names.iter().zip(ridges).enumerate() {
            if !ridge.is_finite() || *ridge < 0.0 || names[..i].contains(name) {
                return Err(invalid(format!(
                    "{name:?} with ridge {ridge}: a ridge must be finite and not negative, and a \
                    name may appear only once"
                )));
            }
            let block = self.block(name)?;
            let count = self.blocks[block].place.len();
            selection.blocks.push(block);
            selection.counts.push(count);
            let total = selection.ridges.len() + count;
            selection.ridges.resize(total, *ridge);
        }
        Ok(selection)
    }

    /// What is fitted together to all frames, with its Gram matrices.
    fn fit(&mut self, names: &[String], ridges: &[f64]) -> Result<Selection> {
        let selection = self.selection(names, ridges)?;
        self.prepare(&selection);
        let (plain, form) = (&self.plain, &self.folds.form);
        for pair in selection.pairs() {
            let known = |_: &Columns, _: &Columns| plain[&pair].clone();
            self.all
                .ensure(&self.blocks, &self.folds.all, form, pair, known);
        }
        Ok(selection)
    }

    /// Make the Grams of all frames without whitening, which every set of frames starts from.
    fn prepare(&mut self, selection: &Selection) {
        for (a, b) in selection.pairs() {
            let make = || {
                let columns = self.blocks[a].columns();
                columns.plain(&self.blocks[b].columns(), &self.folds.all.index)
            };
            self.plain.entry((a, b)).or_insert_with(make);
        }
    }
}

impl Grams {
    /// Make the Gram of two blocks, if it is missing, from the one without whitening.
    fn ensure(
        &mut self,
        blocks: &[Block],
        frames: &Frames,
        form: &[f64],
        (a, b): (usize, usize),
        plain: impl FnOnce(&Columns, &Columns) -> Mat<f64>,
    ) {
        if self.blocks.contains_key(&(a, b)) {
            return;
        }
        let (left, right) = (blocks[a].columns(), blocks[b].columns());
        for (number, columns) in [(a, &left), (b, &right)] {
            let along = self.along.entry(number);
            along.or_insert_with(|| columns.along(frames, form));
        }
        let plain = plain(&left, &right);
        let gram = whitened(plain, &self.along[&a], &self.along[&b]);
        self.blocks.insert((a, b), gram);
    }
}

/// Blocks fitted together, the number of columns of each, and the ridge of each column.
#[derive(Default)]
struct Selection {
    blocks: Vec<usize>,
    counts: Vec<usize>,
    ridges: Vec<f64>,
}

impl Selection {
    /// All pairs of blocks and the residual, the larger number first.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        let every = || self.blocks.iter().copied().chain([RESIDUAL]);
        every().flat_map(move |a| every().filter(move |b| *b <= a).map(move |b| (a, b)))
    }

    /// The first column of each block.
    fn starts(&self) -> impl Iterator<Item = (usize, usize)> {
        let starts = self.counts.iter().scan(0, |first, count| {
            *first += count;
            Some(*first - count)
        });
        self.blocks.iter().copied().zip(starts)
    }

    /// The lower triangle of the normal equations, without ridges.
    fn system(&self, grams: &Grams) -> Mat<f64> {
        let mut system: Mat<f64> = Mat::zeros(self.ridges.len(), self.ridges.len());
        for (i, (a, row)) in self.starts().enumerate() {
            for (b, column) in self.starts().take(i + 1) {
                let gram = &grams.blocks[&(a.max(b), a.min(b))];
                let (rows, columns) = if a >= b {
                    (gram.nrows(), gram.ncols())
                } else {
                    (gram.ncols(), gram.nrows())
                };
                let mut into = system.as_mut().submatrix_mut(row, column, rows, columns);
                if a >= b {
                    into.copy_from(gram);
                } else {
                    into.copy_from(gram.transpose());
                }
            }
        }
        system
    }

    /// The right-hand side (n, 1).
    fn right(&self, grams: &Grams) -> Mat<f64> {
        let mut right: Mat<f64> = Mat::zeros(self.ridges.len(), 1);
        for ((block, first), count) in self.starts().zip(&self.counts) {
            let mut into = right.as_mut().submatrix_mut(first, 0, *count, 1);
            into.copy_from(&grams.blocks[&(block, RESIDUAL)]);
        }
        right
    }

    /// Cholesky factor of G + Λ, and the diagonal of Λ.
    fn factor(&self, grams: &Grams) -> Result<(Llt<f64>, Vec<f64>)> {
        let mut system = self.system(grams);
        let count = self.ridges.len();
        let trace: f64 = (0..count).map(|i| system[(i, i)]).sum();
        let jitter = (JITTER * trace / count.max(1) as f64).max(f64::MIN_POSITIVE);
        let added: Vec<f64> = self.ridges.iter().map(|ridge| ridge + jitter).collect();
        added
            .iter()
            .enumerate()
            .for_each(|(i, ridge)| system[(i, i)] += ridge);
        let factor = system.llt(Side::Lower).map_err(|_| {
            invalid(format!(
                "the normal equations of {count} columns are not positive definite (trace \
                {trace:.3e}); raise the ridges"
            ))
        })?;
        Ok((factor, added))
    }

    /// Solve for θ with one of the Gram matrices.
    fn solve(&self, grams: &Grams) -> Result<Vec<f64>> {
        let mut theta = self.right(grams);
        self.factor(grams)?.0.solve_in_place(theta.as_mut());
        Ok(theta.col_as_slice(0).to_vec())
    }
}

/// Transpose (K, M) to (M, K).
fn transposed(base: &[f64], frames: usize, modes: usize) -> Vec<f64> {
    let column = |m: usize| (0..frames).map(move |k| base[k * modes + m]);
    (0..modes).flat_map(column).collect()
}
