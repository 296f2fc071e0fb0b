//! Commands of the finger to ticks of its servos, by the calibration: ticks = home + A⁻¹ (u − b).
//!
//! With a chain of effects, commands are the target effective commands. The chain, updated with
//! every tick actually sent, is inverted first (`inverse/chain.rs`). Commands far beyond its bounds
//! are passed unchanged to the guard.

use softmap_servo::control::Plan;
use softmap_servo::guard::MOST_SERVOS;

use crate::algebra::dense;
use crate::error::{Result, invalid};
use crate::inverse::chain::Inverse;

/// The map of a calibration, and the effects between command and effective command.
pub struct Map {
    slope: Vec<f64>,
    inverse: Vec<f64>,
    b: Vec<f64>,
    home: Vec<f64>,
    chain: Option<Inverse>,
    period: f64,
}

impl Map {
    /// `slope` A (C, C) mm per tick, `b` (C,) mm, `home` (C,) ticks; `period` is the duration of a
    /// command, s.
    pub fn new(
        slope: Vec<f64>,
        b: Vec<f64>,
        home: Vec<f64>,
        chain: Option<Inverse>,
        period: f64,
    ) -> Result<Map> {
        let count = b.len();
        let finite = [&slope, &b, &home]
            .iter()
            .all(|numbers| numbers.iter().all(|v| v.is_finite()));
        if slope.len() != count * count || home.len() != count || count > MOST_SERVOS || !finite {
            return Err(invalid(format!(
                "a map of {} numbers, {count} shifts and {} homes; expected C², C and C finite \
                numbers, C at most {MOST_SERVOS}",
                slope.len(),
                home.len()
            )));
        }
        if let Some(chain) = chain.as_ref().filter(|chain| chain.channels() != count) {
            return Err(invalid(format!(
                "effects on {} commands before a map of {count}; they must agree",
                chain.channels()
            )));
        }
        let rows: Vec<Vec<f64>> = slope
            .chunks_exact(count.max(1))
            .map(<[f64]>::to_vec)
            .collect();
        let mut inverse = vec![0.0; slope.len()];
        for k in 0..count {
            let unit = (0..count).map(|i| f64::from(i == k)).collect();
            let column = dense::solve(rows.clone(), unit)
                .ok_or_else(|| invalid("a map that is singular: no ticks belong to a command"))?;
            (0..count).for_each(|i| inverse[i * count + k] = column[i]);
        }
        let tick = |row: &[f64]| row.iter().map(|a| a.abs()).sum::<f64>();
        let largest = slope
            .chunks_exact(count.max(1))
            .map(tick)
            .fold(0.0, f64::max);
        Ok(Map {
            chain: chain.map(|chain| chain.with_band(largest)),
            slope,
            inverse,
            b,
            home,
            period,
        })
    }

    fn linear(&self, command: &[f64], ticks: &mut [f64]) {
        let rows = self.inverse.chunks_exact(self.b.len()).zip(&self.home);
        for (tick, (row, home)) in ticks.iter_mut().zip(rows) {
            let away = row
                .iter()
                .zip(command)
                .zip(&self.b)
                .map(|((a, u), b)| a * (u - b));
            *tick = home + away.sum::<f64>();
        }
    }
}

impl Plan for Map {
    fn channels(&self) -> usize {
        self.b.len()
    }

    fn ticks(&mut self, command: &[f64], ticks: &mut [f64]) {
        let Some(chain) = self
            .chain
            .as_mut()
            .filter(|chain| command.iter().all(|u| u.is_finite()) && !chain.absurd(command))
        else {
            // Unchanged: commands rejected without effects are also rejected with them.
            return self.linear(command, ticks);
        };
        let mut sent = [0.0; MOST_SERVOS];
        let sent = &mut sent[..command.len()];
        chain.command(command, self.period, sent);
        self.linear(sent, ticks);
    }

    fn passed(&mut self, ticks: &[i32], period: f64) {
        self.period = period;
        let Some(chain) = &mut self.chain else { return };
        let (mut sent, count) = ([0.0; MOST_SERVOS], self.b.len());
        for (sent, (row, b)) in sent
            .iter_mut()
            .zip(self.slope.chunks_exact(count).zip(&self.b))
        {
            let away = row.iter().zip(ticks).zip(&self.home);
            *sent = b + away
                .map(|((a, tick), home)| a * (f64::from(*tick) - home))
                .sum::<f64>();
        }
        chain.passed(&sent[..count], period);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocations::allocations;
    use crate::effects::{Chain, Context};
    use softmap_servo::guard::reversals::{Budget, Reversals};

    fn inverse(names: &[&str], params: &[f64]) -> Inverse {
        let names: Vec<String> = names.iter().map(|n| n.to_string()).collect();
        let context = Context {
            t: 0.0,
            dt: 0.0,
            gravity: [0.0, 0.0, 1.0],
            load: 0.0,
            temperature: f64::NAN,
            seen_for: 0.0,
        };
        let chain = Chain::new(&names, 2).unwrap();
        let params = chain.spread(params, params.len());
        Inverse::new(&chain, &params, vec![-5.0; 2], vec![5.0; 2], context).unwrap()
    }

    fn map(chain: Option<Inverse>) -> Map {
        let slope = vec![1.0 / 280.0, 0.1 / 280.0, 0.0, 1.0 / 280.0];
        Map::new(slope, vec![0.1, -0.1], vec![2000.0, 1000.0], chain, 0.01).unwrap()
    }

    #[test]
    fn the_map_and_its_inverse_agree() {
        let (mut map, mut ticks) = (map(None), [0.0; 2]);
        map.ticks(&[0.1 + 1.0, -0.1 + 2.0], &mut ticks);
        assert!((ticks[0] - 2000.0 - 280.0 * 0.8).abs() < 1e-9 && (ticks[1] - 1560.0).abs() < 1e-9);
        assert!(Map::new(vec![0.0; 4], vec![0.0; 2], vec![0.0; 2], None, 0.01).is_err());
    }

    /// The worst error of the effective command of a slow figure, rounded to integer ticks, mm.
    #[test]
    fn through_a_play_what_acts_is_what_was_asked_to_a_tick() {
        let truth = Chain::new(&["backlash".to_string()], 2).unwrap();
        let follow = |chain: Option<Inverse>| {
            let mut map = map(chain);
            map.passed(&[2000, 1000], 0.01);
            let mut state = truth.init(&[0.6; 2], &[0.1, -0.1]).unwrap();
            let (mut ticks, mut worst) = ([0.0; 2], 0.0f64);
            for k in 1..2000 {
                let t = 0.01 * f64::from(k);
                let goal = [2.0 * (0.9 * t).sin(), 1.5 * (0.6 * t).sin()];
                map.ticks(&goal, &mut ticks);
                let sent = ticks.map(|t| t.round() as i32);
                map.passed(&sent, 0.01);
                let away = [f64::from(sent[0]) - 2000.0, f64::from(sent[1]) - 1000.0];
                let mut acts = [
                    0.1 + (away[0] + 0.1 * away[1]) / 280.0,
                    -0.1 + away[1] / 280.0,
                ];
                let context = Context {
                    t,
                    dt: 0.01,
                    gravity: [0.0, 0.0, 1.0],
                    load: 0.0,
                    temperature: f64::NAN,
                    seen_for: 0.0,
                };
                truth.step(&[0.6; 2], &mut acts, &mut state, &context);
                worst = worst
                    .max((acts[0] - goal[0]).abs())
                    .max((acts[1] - goal[1]).abs());
            }
            worst
        };
        assert!(follow(None) > 0.25);
        assert!(follow(Some(inverse(&["backlash"], &[0.6]))) < 1.7 / 280.0);
    }

    /// The number of reversals of the ticks in 20 s for a still hand with 5 µm of noise.
    fn turns(names: &[&str], params: &[f64], budget: Option<Budget>) -> usize {
        let mut map = map(Some(inverse(names, params)));
        map.passed(&[2000, 1000], 0.01);
        let none = Budget {
            band: 0.0,
            turns: f64::INFINITY,
            burst: f64::INFINITY,
        };
        let budget = budget.unwrap_or(none);
        let mut hands = [Reversals::new(0.0, &budget); 2];
        let (mut ticks, mut sent, mut way, mut turned) = ([0.0; 2], [2000, 1000], [0; 2], 0);
        let mut seed = 7u64;
        for k in 0..2200 {
            let mut goal = [1.5, -0.8];
            for (hand, goal) in hands.iter_mut().zip(&mut goal) {
                seed = seed
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                let noise = (seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0;
                *goal = hand.step(*goal + 0.005 * noise, 0.01, &budget);
            }
            map.ticks(&goal, &mut ticks);
            for c in 0..2 {
                let next = ticks[c].round() as i32;
                let direction = (next - sent[c]).signum();
                if direction != 0 {
                    // Exclude the approach and the first moments.
                    turned += usize::from(k > 200 && direction != way[c]);
                    way[c] = direction;
                }
                sent[c] = next;
            }
            map.passed(&sent, 0.01);
        }
        turned
    }

    #[test]
    fn a_still_hand_turns_no_servo_through_an_inverted_play() {
        let budget = Some(Budget {
            band: 0.02,
            turns: 4.0,
            burst: 4.0,
        });
        assert_eq!(turns(&["backlash"], &[0.5], budget), 0);
        assert_eq!(
            turns(&["backlash", "hysteresis"], &[0.5, 0.15, 3.0, 1.0], budget),
            0
        );
        // Creep crosses the play once in each channel, and no more.
        assert!(turns(&["backlash", "creep"], &[0.5, 0.1, 10.0, 2.0], budget) <= 2);
        assert!(
            turns(&["backlash"], &[0.5], None) > 200,
            "the noise itself turns nothing"
        );
    }

    #[test]
    fn a_target_that_is_no_number_stays_none_and_spoils_nothing() {
        let (mut map, mut ticks) = (map(Some(inverse(&["backlash"], &[0.6]))), [0.0; 2]);
        map.passed(&[2000, 1000], 0.01);
        map.ticks(&[f64::NAN, 0.0], &mut ticks);
        assert!(ticks[0].is_nan());
        map.ticks(&[0.5, 0.0], &mut ticks);
        assert!(ticks.iter().all(|t| t.is_finite()));
    }

    #[test]
    fn a_command_far_beyond_the_bounds_is_seen_by_the_guard_as_it_is() {
        let mut map = map(Some(inverse(&["backlash"], &[0.6])));
        let (mut far, mut near, mut edge) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        map.passed(&[2000, 1000], 0.01);
        map.ticks(&[1e6, 0.0], &mut far);
        assert!(far[0] > 2.7e8, "{far:?}");
        map.ticks(&[-10.5, 0.0], &mut far);
        assert!((far[0] - 2000.0 + 280.0 * 10.61).abs() < 1.0, "{far:?}");
        map.ticks(&[5.5, 0.0], &mut near);
        map.ticks(&[9.9, 0.0], &mut edge);
        assert_eq!(near, edge, "a little beyond is the edge");
        assert!(near[0] - 2000.0 < 280.0 * 5.1);
    }

    #[test]
    fn a_period_allocates_nothing() {
        let mut map = map(Some(inverse(
            &["backlash", "creep"],
            &[0.6, 0.1, 10.0, 2.0],
        )));
        let mut ticks = [0.0; 2];
        map.passed(&[2000, 1000], 0.01);
        let asked = allocations(|| {
            for k in 0..100 {
                map.ticks(&[0.02 * f64::from(k), -0.5], &mut ticks);
                map.passed(&ticks.map(|t| t as i32), 0.01);
            }
        });
        assert_eq!(asked, 0);
    }
}
