//! Limit reversals: a still hand must not make a servo chatter through a compensated backlash.
//!
//! Compensating a play of 0.5 mm jumps by 0.5 mm at every reversal, even one of 5 µm. So a command
//! follows exactly while it keeps its direction. It turns only once the goal has reversed by more
//! than `band`, and at most `turns` times per second in the long run (`burst` at once). While it
//! may not turn, it stops; its error is at most the reversal of the goal.

/// The limits of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget {
    /// Reversal of a goal before the command turns, mm.
    pub band: f64,
    /// Turns per second.
    pub turns: f64,
    /// Most accumulated turns, at least 1.
    pub burst: f64,
}

/// One channel's command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reversals {
    at: f64,
    /// +1, −1, or 0 before the first move.
    direction: f64,
    left: f64,
    /// Turns so far, and delayed ones (periods).
    pub turned: u64,
    pub refused: u64,
}

impl Reversals {
    /// At rest at `at`, with a full budget.
    pub fn new(at: f64, budget: &Budget) -> Reversals {
        Reversals {
            at,
            direction: 0.0,
            left: budget.burst,
            turned: 0,
            refused: 0,
        }
    }

    /// The command for `goal` (mm, finite), `period` seconds after the last one.
    pub fn step(&mut self, goal: f64, period: f64, budget: &Budget) -> f64 {
        self.left = (self.left + budget.turns * period).min(budget.burst);
        let away = goal - self.at;
        if away * self.direction < 0.0 {
            if away.abs() <= budget.band {
                return self.at;
            }
            if self.left < 1.0 {
                self.refused += 1;
                return self.at;
            }
            self.left -= 1.0;
            self.turned += 1;
        }
        if away != 0.0 {
            self.direction = away.signum();
        }
        self.at = goal;
        self.at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUDGET: Budget = Budget {
        band: 0.02,
        turns: 2.0,
        burst: 3.0,
    };

    fn noise(seed: &mut u64) -> f64 {
        *seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    #[test]
    fn jitter_of_a_still_hand_turns_nothing() {
        let mut seed = 1;
        let mut channel = Reversals::new(1.0, &BUDGET);
        let mut bare = (1.0, 0.0, 0);
        for _ in 0..3000 {
            let goal = 1.0 + 0.005 * noise(&mut seed);
            let command = channel.step(goal, 0.01, &BUDGET);
            assert!((command - goal).abs() <= BUDGET.band);
            let direction = f64::signum(goal - bare.0);
            bare = (goal, direction, bare.2 + i32::from(direction != bare.1));
        }
        assert_eq!((channel.turned, channel.refused), (0, 0));
        assert!(bare.2 > 1000, "the jitter itself turns {} times", bare.2);
    }

    #[test]
    fn a_moving_hand_is_followed_exactly_but_for_the_band_at_its_turns() {
        let mut channel = Reversals::new(0.0, &BUDGET);
        let (mut exact, mut steps) = (0, 0);
        for i in 0..1000 {
            let goal = 2.0 * (0.004 * f64::from(i) * std::f64::consts::TAU).sin();
            let command = channel.step(goal, 0.01, &BUDGET);
            assert!((command - goal).abs() <= BUDGET.band);
            (exact, steps) = (exact + i32::from(command == goal), steps + 1);
        }
        assert_eq!(channel.turned, 8);
        assert!(exact > steps - 8 * 8);
    }

    #[test]
    fn a_trembling_hand_spends_its_budget_and_then_stands() {
        let mut channel = Reversals::new(0.0, &BUDGET);
        for i in 0..1000 {
            channel.step(if i % 2 == 0 { 0.5 } else { -0.5 }, 0.01, &BUDGET);
        }
        // 10 s at 2 per second and 3 at once.
        assert_eq!(channel.turned, 22);
        assert_eq!(channel.refused, 489);
    }

    #[test]
    fn the_first_move_is_no_turn_whichever_way() {
        for goal in [-0.01, 0.01, -1.0, 1.0] {
            let mut channel = Reversals::new(0.0, &BUDGET);
            assert_eq!(channel.step(0.0, 0.01, &BUDGET), 0.0);
            assert_eq!(channel.step(goal, 0.01, &BUDGET), goal);
            assert_eq!((channel.turned, channel.refused), (0, 0), "{goal}");
        }
    }

    #[test]
    fn the_band_itself_is_no_turn_and_the_budget_is_not_saved_beyond_its_burst() {
        let budget = Budget {
            band: 0.25,
            turns: 1.0,
            burst: 1.0,
        };
        let mut channel = Reversals::new(0.0, &budget);
        assert_eq!(channel.step(1.0, 100.0, &budget), 1.0);
        assert_eq!(channel.step(0.75, 0.0, &budget), 1.0);
        assert_eq!(channel.step(0.7, 0.0, &budget), 0.7);
        assert_eq!(channel.step(0.7, 0.0, &budget), 0.7);
        assert_eq!(channel.step(1.0, 0.0, &budget), 0.7);
        assert_eq!(channel.step(0.7, 0.0, &budget), 0.7);
        assert_eq!(channel.step(0.6, 0.0, &budget), 0.6);
        assert_eq!(channel.step(1.0, 1.0, &budget), 1.0);
        assert_eq!((channel.turned, channel.refused), (2, 1));
    }
}
