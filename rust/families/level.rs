//! Level 1 of the diagnosis: ridge regression of a residual on the columns of families, with blocked cross-validation.
//!
//! Columns are added by name (`gram.rs`). `close` takes the residual and builds all Gram matrices once: for the training and
//! test frames of each fold, and for all frames. Every fit after that is a small solve: θ = (G + Λ)⁻¹ b from the training
//! frames, and the held-out loss |y − Xθ|² from the Gram of the test frames. Λ holds the ridge of each name plus 1e-9 of the
//! mean diagonal, which makes collinear columns solvable. Checked by tests/test_level.py.

use super::gram::{Columns, Frames, Packed};
use crate::error::{Result, invalid};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Share of the mean diagonal that is added to it: makes collinear columns solvable.
const JITTER: f64 = 1e-9;

/// A set of frames with the basis (frames, r) and strength (r,) of its kernel, not yet checked.
pub struct FrameSet {
    pub index: Vec<usize>,
    pub basis: Vec<f64>,
    pub strength: Vec<f64>,
}

/// Range of the columns of one name.
struct Block {
    name: String,
    columns: Range<usize>,
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

/// Columns by name, and their normal equations once the residual is known.
pub struct Level {
    folds: Arc<Folds>,
    frames: usize,
    /// Distinct bases (M, K).
    bases: Vec<Vec<f64>>,
    blocks: Vec<Block>,
    /// Base and weight (K,) of each column.
    base: Vec<usize>,
    weight: Vec<Vec<f64>>,
    grams: Option<Grams>,
}

/// Gram matrices of all columns, sorted by base, with the residual last.
struct Grams {
    /// Position of each column in the Gram matrices.
    place: Vec<usize>,
    all: Packed,
    folds: Vec<(Packed, Packed)>,
}

impl Level {
    /// Create a level from the model-error variance (M,) of each mode, the set of all frames, and (train, test) of each fold.
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
        Level {
            folds,
            frames,
            bases: vec![],
            blocks: vec![],
            base: vec![],
            weight: vec![],
            grams: None,
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
        self.blocks.iter().map(|block| &*block.name).collect()
    }

    /// Add columns X_j = base[which_j] ∘ weight_j under a name: `base` (s, K, M), `which` (n,), `weight` (n, K).
    pub fn add(&mut self, name: &str, base: &[f64], which: &[usize], weight: &[f64]) -> Result<()> {
        if self.blocks.iter().any(|block| block.name == name) {
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
        let known: Vec<usize> = base
            .chunks_exact(size)
            .map(|base| self.intern(base))
            .collect();
        let first = self.base.len();
        self.base.extend(which.iter().map(|which| known[*which]));
        let rows = weight.chunks_exact(self.frames);
        self.weight.extend(rows.map(<[f64]>::to_vec));
        self.blocks.push(Block {
            name: name.into(),
            columns: first..self.base.len(),
        });
        self.grams = None;
        Ok(())
    }

    /// Store a base (K, M) and return its number. Families share the slopes, so equal bases are stored once.
    fn intern(&mut self, base: &[f64]) -> usize {
        let by_modes = transposed(base, self.frames, self.modes());
        let known = self.bases.iter().position(|base| *base == by_modes);
        known.unwrap_or_else(|| {
            self.bases.push(by_modes);
            self.bases.len() - 1
        })
    }

    /// Build the Gram matrices of all columns and the residual (K, M), whose modes are in units of noise.
    pub fn close(&mut self, residual: &[f64]) -> Result<()> {
        self.modes_of("residual", residual)?;
        let residual = transposed(residual, self.frames, self.modes());
        let ones = vec![1.0; self.frames];
        let mut order: Vec<usize> = (0..self.base.len()).collect();
        order.sort_by_key(|j| self.base[*j]);
        let mut place = vec![0; order.len()];
        for (at, j) in order.iter().enumerate() {
            place[*j] = at;
        }
        let bases: Vec<&[f64]> = self
            .bases
            .iter()
            .chain([&residual])
            .map(|base| &**base)
            .collect();
        let columns = Columns {
            base: order
                .iter()
                .map(|j| self.base[*j])
                .chain([self.bases.len()])
                .collect(),
            weight: order
                .iter()
                .map(|j| &*self.weight[*j])
                .chain([&*ones])
                .collect(),
            bases: &bases,
            form: &self.folds.form,
            total: self.frames,
        };
        // Without whitening, the Gram of the training frames is that of all frames less that of the few others.
        let (all, plain) = columns.grams(&self.folds.all);
        let both = |fold: &Fold| {
            let rest = columns.plain(&fold.others);
            let train = columns.whitened(&fold.train, &plain - &rest);
            (train, columns.grams(&fold.test).0)
        };
        let folds = self.folds.each.par_iter().map(both).collect();
        self.grams = Some(Grams { place, all, folds });
        Ok(())
    }

    /// Held-out loss (F,) of each fold, fitting the columns of `names` with one ridge each. Without names: loss of the residual.
    pub fn losses(&self, names: &[String], ridges: &[f64]) -> Result<Vec<f64>> {
        let (grams, selection) = (self.closed()?, self.selection(names, ridges)?);
        let y = grams.place.len();
        let loss = |(train, test): &(Packed, Packed)| {
            let theta = selection.solve(grams, train)?;
            let at: Vec<usize> = selection.places(grams).collect();
            let mut loss = test.at(y, y);
            for (i, (theta_i, at_i)) in theta.iter().zip(&at).enumerate() {
                let others = theta[..i].iter().zip(&at);
                let crossed: f64 = others.map(|(theta, at)| theta * test.at(*at_i, *at)).sum();
                let own = 0.5 * theta_i * test.at(*at_i, *at_i) + crossed - test.at(y, *at_i);
                loss += 2.0 * theta_i * own;
            }
            Ok(loss)
        };
        grams.folds.par_iter().map(loss).collect()
    }

    /// Fit all frames; return the column weights of each of `names`.
    pub fn theta(&self, names: &[String], ridges: &[f64]) -> Result<Vec<Vec<f64>>> {
        let (grams, selection) = (self.closed()?, self.selection(names, ridges)?);
        let theta = selection.solve(grams, &grams.all)?;
        let mut rest = theta.as_slice();
        let parts = names.iter().map(|name| {
            let (mine, others) = rest.split_at(self.block(name)?.columns.len());
            rest = others;
            Ok(mine.to_vec())
        });
        parts.collect()
    }

    /// Effective degrees of freedom of `name` in a fit of all `names`: the trace of its block of (G + Λ)⁻¹ G.
    pub fn freedom(&self, names: &[String], ridges: &[f64], name: &str) -> Result<f64> {
        let (grams, selection) = (self.closed()?, self.selection(names, ridges)?);
        let mut first = 0;
        for other in names.iter().take_while(|other| *other != name) {
            first += self.block(other)?.columns.len();
        }
        if !names.iter().any(|other| other == name) {
            return Err(invalid(format!(
                "{name:?} is not one of the fitted names {names:?}"
            )));
        }
        let count = self.block(name)?.columns.len();
        let (factor, added) = selection.factor(grams, &grams.all)?;
        let mut inverse: Mat<f64> = Mat::zeros(selection.columns.len(), count);
        for j in 0..count {
            inverse[(first + j, j)] = 1.0;
        }
        factor.solve_in_place(inverse.as_mut());
        let held = (0..count).map(|j| added[first + j] * inverse[(first + j, j)]);
        Ok(count as f64 - held.sum::<f64>())
    }

    /// Modes (K, M) of the columns of a name with weights `theta` (n,), not whitened.
    pub fn fitted(&self, name: &str, theta: &[f64]) -> Result<Vec<f64>> {
        let columns = self.block(name)?.columns.clone();
        if theta.len() != columns.len() {
            return Err(invalid(format!(
                "theta has {} weights, but {name:?} has {} columns",
                theta.len(),
                columns.len()
            )));
        }
        let mut by_modes = vec![0.0; self.frames * self.modes()];
        for (j, theta) in columns.zip(theta) {
            let rows = by_modes.chunks_exact_mut(self.frames);
            for (out, base) in rows.zip(self.bases[self.base[j]].chunks_exact(self.frames)) {
                for ((out, base), weight) in out.iter_mut().zip(base).zip(&self.weight[j]) {
                    *out += theta * base * weight;
                }
            }
        }
        Ok(transposed(&by_modes, self.modes(), self.frames))
    }

    /// Loss (F,) of fixed modes (K, M) on the test frames of each fold, without any fit.
    pub fn losses_of(&self, modes: &[f64]) -> Result<Vec<f64>> {
        self.modes_of("modes", modes)?;
        let modes = transposed(modes, self.frames, self.modes());
        let ones = vec![1.0; self.frames];
        let columns = Columns {
            base: vec![0],
            weight: vec![&ones],
            bases: &[&modes],
            form: &self.folds.form,
            total: self.frames,
        };
        let loss = |fold: &Fold| columns.grams(&fold.test).0.at(0, 0);
        Ok(self.folds.each.iter().map(loss).collect())
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

    fn closed(&self) -> Result<&Grams> {
        self.grams.as_ref().ok_or_else(|| {
            invalid(
                "there are no normal equations for the present columns; call close(residual) first",
            )
        })
    }

    fn block(&self, name: &str) -> Result<&Block> {
        let found = self.blocks.iter().find(|block| block.name == name);
        found.ok_or_else(|| {
            invalid(format!(
                "unknown columns {name:?}; available: {}",
                self.names().join(", ")
            ))
        })
    }

    fn selection(&self, names: &[String], ridges: &[f64]) -> Result<Selection> {
        if names.len() != ridges.len() {
            return Err(invalid(format!(
                "{} names and {} ridges; give one ridge per name",
                names.len(),
                ridges.len()
            )));
        }
        let mut selection = Selection {
            columns: vec![],
            ridges: vec![],
        };
        for (i, (name, ridge)) in names.iter().zip(ridges).enumerate() {
            if !ridge.is_finite() || *ridge < 0.0 || names[..i].contains(name) {
                return Err(invalid(format!(
                    "{name:?} with ridge {ridge}: a ridge must be finite and not negative, and a name may appear only once"
                )));
            }
            selection.columns.extend(self.block(name)?.columns.clone());
            selection.ridges.resize(selection.columns.len(), *ridge);
        }
        Ok(selection)
    }
}

/// Columns fitted together, with the ridge of each.
struct Selection {
    columns: Vec<usize>,
    ridges: Vec<f64>,
}

impl Selection {
    fn places<'a>(&'a self, grams: &'a Grams) -> impl Iterator<Item = usize> + 'a {
        self.columns.iter().map(|j| grams.place[*j])
    }

    /// Cholesky factor of G + Λ, and the diagonal of Λ.
    fn factor(&self, grams: &Grams, gram: &Packed) -> Result<(Llt<f64>, Vec<f64>)> {
        let at: Vec<usize> = self.places(grams).collect();
        let trace: f64 = at.iter().map(|at| gram.at(*at, *at)).sum();
        let jitter = (JITTER * trace / at.len().max(1) as f64).max(f64::MIN_POSITIVE);
        let added: Vec<f64> = self.ridges.iter().map(|ridge| ridge + jitter).collect();
        let mut system: Mat<f64> = Mat::zeros(at.len(), at.len());
        for j in 0..at.len() {
            let column = &mut system.col_as_slice_mut(j)[j..];
            for (value, at_i) in column.iter_mut().zip(&at[j..]) {
                *value = gram.at(*at_i, at[j]);
            }
            column[0] += added[j];
        }
        let factor = system.llt(Side::Lower).map_err(|_| {
            invalid(format!(
                "the normal equations of {} columns are not positive definite (trace {trace:.3e}); raise the ridges",
                at.len()
            ))
        })?;
        Ok((factor, added))
    }

    /// Solve for θ with one of the Gram matrices.
    fn solve(&self, grams: &Grams, gram: &Packed) -> Result<Vec<f64>> {
        let y = grams.place.len();
        let mut theta: Mat<f64> = Mat::zeros(self.columns.len(), 1);
        for (i, at) in self.places(grams).enumerate() {
            theta[(i, 0)] = gram.at(y, at);
        }
        self.factor(grams, gram)?.0.solve_in_place(theta.as_mut());
        Ok(theta.col_as_slice(0).to_vec())
    }
}

/// Transpose (K, M) to (M, K).
fn transposed(base: &[f64], frames: usize, modes: usize) -> Vec<f64> {
    let column = |m: usize| (0..frames).map(move |k| base[k * modes + m]);
    (0..modes).flat_map(column).collect()
}
