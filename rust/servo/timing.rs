//! Timing of a loop: counts of lateness, without allocation.

/// Counts of lateness.
#[derive(Debug, Clone)]
pub struct Timing {
    pub ticks: u64,
    pub overruns: u64,
    /// Ticks by lateness, and commands by age: four bins per doubling, from 1 µs on.
    pub late: [u64; BINS],
    pub age: [u64; BINS],
}

/// Bins of a count; the last ends beyond an hour.
pub const BINS: usize = 128;

impl Default for Timing {
    fn default() -> Timing {
        Timing {
            ticks: 0,
            overruns: 0,
            late: [0; BINS],
            age: [0; BINS],
        }
    }
}

impl Timing {
    pub(crate) fn note(bins: &mut [u64; BINS], ns: u64) {
        let us = ns / 1000;
        let bin = match us {
            0..4 => us as usize,
            _ => {
                let doublings = us.ilog2() as usize;
                4 * (doublings - 1) + (us >> (doublings - 2) & 3) as usize
            }
        };
        bins[bin.min(BINS - 1)] += 1;
    }

    /// The upper edge (µs) of a bin.
    fn edge(bin: usize) -> f64 {
        match bin {
            0..4 => (bin + 1) as f64,
            _ => ((bin % 4 + 5) as f64) * 2f64.powi(bin as i32 / 4 - 1),
        }
    }

    /// The upper edge (µs) of the bin in which the share `q` of `bins` ends.
    pub fn quantile(bins: &[u64; BINS], q: f64) -> f64 {
        let wanted = (q * bins.iter().sum::<u64>() as f64).ceil();
        let mut sum = 0.0;
        for (bin, count) in bins.iter().enumerate() {
            sum += *count as f64;
            if sum >= wanted {
                return Timing::edge(bin);
            }
        }
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_lie_side_by_side_and_hold_what_is_counted() {
        let mut last = 0.0;
        for bin in 0..BINS {
            let edge = Timing::edge(bin);
            assert!(edge > last && edge <= (1.3 * last).max(last + 1.0));
            for us in [last, (last + edge) / 2.0, edge - 1.0] {
                let mut bins = [0; BINS];
                Timing::note(&mut bins, us as u64 * 1000);
                if us as u64 >= last as u64 && bin < BINS - 1 {
                    assert_eq!(bins[bin], 1, "{us} µs in bin {bin}");
                }
            }
            last = edge;
        }
        let mut bins = [0; BINS];
        Timing::note(&mut bins, u64::MAX);
        assert_eq!(bins[BINS - 1], 1);
    }
}
