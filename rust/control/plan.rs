//! Commands of the finger to ticks of its servos: ticks = home + A⁻¹ (u − b), the calibration's own map.

use softmap_servo::control::Plan;

use crate::error::{Result, invalid};

/// The map of a calibration.
pub struct Linear {
    inverse: Vec<f64>,
    b: Vec<f64>,
    home: Vec<f64>,
}

impl Linear {
    /// `inverse` (C, C) ticks a mm, `b` (C,) mm, `home` (C,) ticks.
    pub fn new(inverse: Vec<f64>, b: Vec<f64>, home: Vec<f64>) -> Result<Linear> {
        let count = b.len();
        let finite = [&inverse, &b, &home]
            .iter()
            .all(|numbers| numbers.iter().all(|v| v.is_finite()));
        if inverse.len() != count * count || home.len() != count || !finite {
            return Err(invalid(format!(
                "a map of {} numbers, {count} shifts and {} homes; expected C², C and C finite numbers",
                inverse.len(),
                home.len()
            )));
        }
        Ok(Linear { inverse, b, home })
    }
}

impl Plan for Linear {
    fn channels(&self) -> usize {
        self.b.len()
    }

    fn ticks(&mut self, command: &[f64], ticks: &mut [f64]) {
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

    fn passed(&mut self, _ticks: &[i32], _period: f64) {}
}
