//! The path of a goal: as fast as window, slew and acceleration limits allow, and always able to
//! stop.
//!
//! With d ticks ahead and A ticks per period² of braking, the fastest speed v from which a stop
//! fits into d is the one whose braking sum v + (v−A) + (v−2A) + … equals d: n = ⌊(√(1 + 8d/A) −
//! 1)/2⌋, v = (d + A n(n+1)/2)/(n+1). Below this speed towards the window's edges, it can always
//! brake, so the three limits do not conflict; round-off is resolved in the order window, slew,
//! acceleration.

/// Limits of one servo: ticks, ticks per period, ticks per period².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    pub low: f64,
    pub high: f64,
    pub slew: f64,
    pub acceleration: f64,
}

/// Position and speed of a goal: ticks, ticks per period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Path {
    pub at: f64,
    pub speed: f64,
}

impl Path {
    /// At rest at `at`.
    pub fn rest(at: f64) -> Path {
        Path { at, speed: 0.0 }
    }

    /// Advance by one period towards `target`, not faster than `cruise` once that speed is reached.
    pub fn step(&mut self, target: f64, cruise: f64, bounds: &Bounds) {
        let most = |distance: f64| fastest(distance, bounds.acceleration);
        let away = target - self.at;
        let wanted = most(away.abs()).min(cruise).copysign(away);
        let speed = wanted
            .clamp(
                self.speed - bounds.acceleration,
                self.speed + bounds.acceleration,
            )
            .clamp(-bounds.slew, bounds.slew)
            .clamp(-most(self.at - bounds.low), most(bounds.high - self.at));
        let next = (self.at + speed).clamp(bounds.low, bounds.high);
        (self.speed, self.at) = (next - self.at, next);
    }

    /// Brake as fast as allowed.
    pub fn brake(&mut self, bounds: &Bounds) {
        self.step(self.at, 0.0, bounds);
    }

    /// The tick to send, rounded.
    pub fn goal(&self) -> i32 {
        self.at.round() as i32
    }
}

/// The fastest speed from which a stop fits into `distance`; 0 if there is none.
fn fastest(distance: f64, acceleration: f64) -> f64 {
    let distance = distance.max(0.0);
    let steps = (((1.0 + 8.0 * distance / acceleration).sqrt() - 1.0) / 2.0).floor();
    (distance + acceleration * steps * (steps + 1.0) / 2.0) / (steps + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bounds(low: f64, high: f64, slew: f64, acceleration: f64) -> Bounds {
        Bounds {
            low,
            high,
            slew,
            acceleration,
        }
    }

    #[test]
    fn arrives_at_rest_in_the_shortest_time() {
        // 100 ticks at 1 tick/period² and slew 5: up 1,2,3,4 (10), five a step, down 4,3,2,1 (10):
        // 80/5 = 16 steps.
        let bounds = bounds(-10.0, 200.0, 5.0, 1.0);
        let mut path = Path::rest(0.0);
        let mut steps = 0;
        while (path.at != 100.0 || path.speed != 0.0) && steps < 100 {
            path.step(100.0, 5.0, &bounds);
            steps += 1;
        }
        assert_eq!(steps, 4 + 16 + 4 + 1);
        assert_eq!(path.goal(), 100);
    }

    #[test]
    fn the_braking_sum_is_the_distance() {
        for i in 0..2000 {
            let (distance, acceleration) = (f64::from(i) * 0.37, 0.013 * f64::from(i % 7 + 1));
            let mut speed = fastest(distance, acceleration);
            let (mut sum, mut steps) = (0.0, 0);
            while speed > 0.0 && steps < 1000 {
                sum += speed;
                speed -= acceleration;
                steps += 1;
            }
            assert!(
                (sum - distance).abs() < 1e-8 * distance.max(1.0),
                "{distance} {sum}"
            );
        }
        assert_eq!(fastest(-1.0, 1.0), 0.0);
    }

    #[test]
    fn slows_down_to_a_slower_cruise_within_the_limits() {
        let bounds = bounds(0.0, 1e4, 10.0, 0.5);
        let mut path = Path::rest(0.0);
        (0..100).for_each(|_| path.step(1e4, 10.0, &bounds));
        assert_eq!(path.speed, 10.0);
        path.step(1e4, 5.0, &bounds);
        assert_eq!(path.speed, 9.5);
        (0..20).for_each(|_| path.step(1e4, 5.0, &bounds));
        assert_eq!(path.speed, 5.0);
        (0..9).for_each(|_| path.brake(&bounds));
        assert_eq!(path.speed, 0.5);
        path.brake(&bounds);
        let stood = path;
        path.brake(&bounds);
        assert_eq!((path.speed, path), (0.0, stood));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]

        #[test]
        fn no_target_leads_beyond_a_limit(
            high in 1.0..5000.0f64, slew in 0.001..200.0f64, acceleration in 0.0001..100.0f64, start in 0.0..1.0f64,
            targets in prop::collection::vec((-9000.0..9000.0f64, 1usize..60, 0.0..200.0f64), 1..20)
        ) {
            let bounds = bounds(-high, high, slew, acceleration);
            let mut path = Path::rest((2.0 * start - 1.0) * high);
            for (target, steps, cruise) in targets {
                for _ in 0..steps {
                    let before = path;
                    path.step(target, cruise, &bounds);
                    prop_assert!(path.at.abs() <= high);
                    prop_assert!(path.speed.abs() <= slew + 1e-9);
                    let off = (path.speed - before.speed).abs() - acceleration;
                    prop_assert!(off <= 1e-9 * high.max(1.0), "{off} {before:?} {path:?}");
                }
            }
        }
    }
}
