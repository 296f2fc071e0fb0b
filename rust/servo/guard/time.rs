//! Time of the guard: the larger of clock time and counted periods.

/// A moment, by the clock (ns) and by counted periods.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Stamp {
    clock: u64,
    count: u64,
}

/// The present moment.
#[derive(Debug, Clone)]
pub(super) struct Time {
    pub now: Stamp,
    period: f64,
    last: Option<u64>,
}

impl Time {
    /// Begin to count, `period` in s.
    pub fn new(period: f64) -> Time {
        Time {
            now: Stamp::default(),
            period,
            last: None,
        }
    }

    /// One more period, with the clock at `now`; a clock that stops or goes back counts as one
    /// period.
    pub fn pass(&mut self, now: u64) {
        let passed = match self.last {
            Some(last) if now > last => now - last,
            _ => (self.period * 1e9) as u64,
        };
        self.last = Some(now);
        self.now.clock = self.now.clock.saturating_add(passed);
        self.now.count += 1;
    }

    /// Seconds since `stamp`.
    pub fn since(&self, stamp: Stamp) -> f64 {
        let counted = (self.now.count - stamp.count) as f64 * self.period;
        ((self.now.clock - stamp.clock) as f64 * 1e-9).max(counted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_stands_or_goes_back_stretches_nothing() {
        let mut time = Time::new(0.5);
        time.pass(5_000_000_000);
        let start = time.now;
        for (now, since) in [
            (5_750_000_000, 0.75),
            (5_750_000_000, 1.25),
            (4_000_000_000, 1.75),
        ] {
            time.pass(now);
            assert_eq!(time.since(start), since);
        }
        (1..=10).for_each(|crawl| time.pass(4_000_000_000 + crawl));
        assert_eq!(
            time.since(start),
            6.5,
            "periods count where the clock crawls"
        );
        time.pass(u64::MAX);
        assert!(time.since(start) > 1e10);
        time.pass(0);
        time.pass(u64::MAX);
        assert!(time.since(start) > 1e10);
    }
}
