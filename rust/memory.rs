//! Limits of the memory of one result, checked before allocation: a failed allocation ends the
//! process.

use crate::error::{Result, invalid};

/// Largest result, bytes; also the limit for reading an array archive
/// (`softmap_edge/files/npz.py`).
const MOST: usize = 4 << 30;
/// Size from which the system's free memory is checked, bytes; below, the check costs more than it
/// saves.
const LARGE: usize = 64 << 20;

/// The product of `lengths`; an error if that many float64 exceed the limit of a result or the
/// machine's memory.
pub fn room(what: &str, lengths: &[usize]) -> Result<usize> {
    let refused = |why: &str| {
        let bytes = lengths.iter().map(|&n| n as f64).product::<f64>() * 8.0;
        invalid(format!(
            "{what} of {lengths:?} numbers needs {:.3e} GB, {why}; ask for less at once",
            bytes / 1e9
        ))
    };
    let count = lengths
        .iter()
        .try_fold(1usize, |product, &n| product.checked_mul(n));
    let Some(count) = count.filter(|&n| n <= MOST / 8) else {
        return Err(refused("allowed are 4.3 GB"));
    };
    if count > LARGE / 8 && Vec::<f64>::new().try_reserve_exact(count).is_err() {
        return Err(refused("more than this machine has free"));
    }
    Ok(count)
}

/// Zeros for the product of `lengths`, under the same limits.
pub fn zeros(what: &str, lengths: &[usize]) -> Result<Vec<f64>> {
    Ok(vec![0.0; room(what, lengths)?])
}

/// Most numbers of a workspace on the stack.
const FEW: usize = 128;

/// Work with `count` zeros, on the stack if they are few: work at every frame must not allocate
/// each time.
#[inline(always)]
pub fn with_few<R>(count: usize, work: impl FnOnce(&mut [f64]) -> R) -> R {
    if count <= FEW {
        work(&mut [0.0; FEW][..count])
    } else {
        work(&mut vec![0.0; count])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_that_overflow_or_exceed_the_limit_are_refused_in_one_line() {
        for lengths in [
            vec![1 << 21, 1 << 22, 1 << 21],
            vec![usize::MAX, 2],
            vec![1 << 20, 1000],
        ] {
            let message = room("a thing", &lengths).unwrap_err().to_string();
            assert!(
                message.contains("GB") && !message.contains('\n'),
                "{message}"
            );
        }
        assert_eq!(zeros("a thing", &[3, 4]).unwrap(), vec![0.0; 12]);
        assert_eq!(room("nothing", &[1 << 40, 0]).unwrap(), 0);
    }
}
