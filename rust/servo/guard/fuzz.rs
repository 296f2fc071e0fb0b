//! Ten million periods of random events, checked by `checker.rs`; and deliberately broken guards.

use super::checker::{Checker, Said};
use super::{Axis, Budget, Cause, Feedback, Guard, Health, Input, Limits, Message, Request, State};

const TICKS: usize = 10_000_000;
const EPISODE: usize = 4_000;

/// Periods to play: ten million, but where mutants are tested by the hundred
/// (`rust/servo/prove.py`).
fn periods() -> usize {
    std::env::var("SOFTMAP_FUZZ_PERIODS").map_or(TICKS, |count| count.parse().unwrap())
}

/// Random numbers (xorshift*, Marsaglia 2003; Vigna 2016).
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }

    fn once_in(&mut self, count: u64) -> bool {
        self.next().is_multiple_of(count)
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[(self.next() % all.len() as u64) as usize]
    }
}

fn limits(chance: &mut Chance) -> Limits {
    let period = chance.of(&[0.001, 0.002, 0.005, 0.01, 0.02]);
    let count = 1 + (chance.next() % 4) as usize;
    let axis = |chance: &mut Chance| {
        let home = chance.within(-20_000.0, 20_000.0) as i32;
        let slew = chance.within(100.0, 6000.0);
        Axis {
            home,
            low: home - chance.within(50.0, 2000.0) as i32,
            high: home + chance.within(50.0, 2000.0) as i32,
            slew,
            acceleration: chance.within(500.0, 60_000.0),
            current: chance.of(&[Some(600.0), Some(200.0), None]),
            fastest: slew + chance.within(500.0, 5000.0),
            following: chance.within(100.0, 800.0),
            warm: 50.0,
            hot: 60.0,
            voltage: (4.0, 6.0),
        }
    };
    let late = chance.within(4.0 * period, 0.1_f64.max(5.0 * period));
    Limits {
        period,
        axes: (0..count).map(|_| axis(chance)).collect(),
        stale: chance.within(0.05, 0.4),
        hold: chance.within(0.05, 1.0),
        slacken: chance.within(0.2, 3.0),
        late,
        silent: late + chance.within(0.0, 0.2),
        grace: chance.within(0.05, 0.5),
        ramp: chance.within(0.0, 0.5),
        jump: (chance.within(0.0, 200.0), chance.within(400.0, 5000.0)),
        jog_travel: 100.0,
        jog_slew: 100.0,
        jog_current: 100.0,
        budget: Budget {
            band: 0.02,
            turns: 4.0,
            burst: 4.0,
        },
    }
    .checked()
    .unwrap()
}

/// A robot that mostly follows its commands, a mostly sensible user, and occasional random events.
struct World {
    chance: Chance,
    limits: Limits,
    now: u64,
    at: Vec<f64>,
    broken: Vec<u64>,
    /// Periods of silence of one part, or of calm.
    away: u64,
    target: Vec<f64>,
    feedback: Vec<Option<Feedback>>,
    clock: f64,
}

impl World {
    fn new(seed: u64) -> World {
        let mut chance = Chance(seed);
        let limits = limits(&mut chance);
        let homes: Vec<f64> = limits
            .axes
            .iter()
            .map(|axis| f64::from(axis.home))
            .collect();
        World {
            chance,
            now: 1_000_000,
            at: homes.clone(),
            broken: vec![0; homes.len()],
            away: 0,
            feedback: vec![None; homes.len()],
            target: homes,
            limits,
            clock: 0.0,
        }
    }

    /// The next input of the guard, from its last goals and state.
    fn tell(
        &mut self,
        guard: &Guard,
        torque: bool,
    ) -> (Option<bool>, bool, bool, Option<Request>, bool) {
        let period = self.limits.period;
        let steps = [0.0, -5.0, 300.0, 2000.0];
        let passed = if self.chance.once_in(3000) {
            self.chance.of(&steps)
        } else {
            self.chance.within(0.9, 1.1)
        };
        self.now = (self.now as f64 + passed * period * 1e9).max(0.0) as u64;
        // If this computer sleeps, the servos' clocks continue; occasionally only its own clock
        // jumps.
        let slept = passed > 2.0 && !self.chance.once_in(4);
        self.clock += period * 1000.0 * if slept { passed } else { 1.0 };
        for k in 0..self.at.len() {
            if self.chance.once_in(20_000) {
                self.broken[k] = 1 + self.chance.next() % 10;
            } else if self.chance.once_in(150) {
                self.broken[k] = 0;
            }
            let axis = self.limits.axes[k];
            if torque && self.broken[k] != 1 {
                let away = f64::from(guard.goals()[k]) - self.at[k];
                self.at[k] += (0.3 * away).clamp(-axis.fastest * period, axis.fastest * period);
            }
            if self.broken[k] == 2 {
                self.at[k] += self.chance.within(-9000.0, 9000.0);
                self.broken[k] = 0;
            }
            if self.chance.once_in(400) && !torque {
                self.at[k] = f64::from(axis.home);
            }
            let quiet = self.broken[k] == 3 || self.chance.once_in(60);
            let is = |fault| self.broken[k] == fault;
            let health = Health {
                hardware: if is(4) { 0x20 } else { 0 },
                torque: torque && !is(5),
                tripped: is(6),
            };
            let frozen = if is(9) { 7.0 } else { self.clock };
            let voltage = if is(7) {
                self.chance.of(&[0.0, 99.0, f64::NAN])
            } else {
                5.0
            };
            let temperature = if is(8) {
                self.chance.of(&[61.0, 200.0, f64::NAN])
            } else {
                30.0 + 25.0 * self.chance.share()
            };
            let current = if is(10) {
                self.chance.of(&[9e9, f64::NAN])
            } else {
                100.0
            };
            self.feedback[k] = (!quiet).then_some(Feedback {
                position: self.at[k].round() as i32,
                clock: (frozen as u64 % 0x8000) as u16,
                current: axis.current.map(|_| current),
                voltage,
                temperature,
                health: Some(health),
            });
        }
        if self.chance.once_in(2000) {
            self.away = self.chance.next() % (2.0 / period) as u64;
        }
        self.away = self.away.saturating_sub(1);
        let jumps = self.chance.once_in(300);
        for (k, target) in self.target.iter_mut().enumerate() {
            let axis = self.limits.axes[k];
            let wide = 1.5 * f64::from(axis.high - axis.low);
            *target = match self.chance.next() % 4000 {
                0 => self.chance.of(&[
                    f64::NAN,
                    f64::INFINITY,
                    f64::NEG_INFINITY,
                    1e300,
                    -1e300,
                    1_048_575.0,
                    f64::MIN_POSITIVE,
                ]),
                _ if jumps || !target.is_finite() => {
                    f64::from(axis.home) + self.chance.within(-wide, wide)
                }
                _ => *target + self.chance.within(-3.0, 3.0),
            };
        }
        let heard = (self.away == 0 && !self.chance.once_in(3)).then(|| !self.chance.once_in(1500));
        let forward = match guard.state() {
            State::Off => Request::Connect,
            State::Connected => {
                self.chance
                    .of(&[Request::Home, Request::Home, Request::Commission])
            }
            State::Homed => self
                .chance
                .of(&[Request::Arm, Request::Arm, Request::Commission]),
            State::Ready => Request::Engage,
            State::Fault => Request::Acknowledge,
            _ => self.chance.of(&[Request::Stop, Request::Hold]),
        };
        let often = if guard.state().active() { 3000 } else { 20 };
        let request = if self.chance.once_in(often) {
            Some(forward)
        } else {
            self.chance
                .once_in(3000)
                .then(|| self.chance.of(&Request::ALL))
        };
        (
            heard,
            !self.chance.once_in(10),
            self.chance.once_in(4),
            request,
            self.chance.once_in(30_000),
        )
    }
}

/// Run `ticks` periods; `breaks` may change the outputs of the guard.
fn play(
    seed: u64,
    ticks: usize,
    seen: &mut [[u64; 16]; 2],
    breaks: &mut dyn FnMut(&mut Said, State),
) -> Result<(), String> {
    let mut world = World::new(seed);
    let mut guard = Guard::new(world.limits.clone());
    let mut checker = Checker::new(world.limits.clone());
    let mut torque = false;
    for tick in 0..ticks {
        let (heard, new, again, request, emergency) = world.tell(&guard, torque);
        let from = guard.state();
        let input = Input {
            now: world.now,
            feedback: &world.feedback,
            message: heard.map(|deadman| Message {
                deadman,
                goal: new.then_some(&world.target[..]),
            }),
            again: again.then_some(&world.target[..]),
            request,
            emergency,
        };
        let output = guard.tick(&input);
        torque = output.torque;
        seen[0][output.state as usize] += 1;
        seen[1][output.cause as usize] += u64::from(output.state != from);
        let mut said = Said {
            output,
            goals: guard.goals().to_vec(),
            paths: guard.paths().iter().map(|path| path.at).collect(),
            currents: guard.currents().to_vec(),
        };
        breaks(&mut said, from);
        checker
            .judge(&input, &said)
            .map_err(|fault| format!("seed {seed}, period {tick}: {fault}"))?;
    }
    Ok(())
}

#[test]
fn ten_million_periods_without_an_unsafe_tick() {
    let mut seen = [[0; 16]; 2];
    let periods = periods();
    for episode in 0..(periods / EPISODE) as u64 {
        play(7919 * episode + 1, EPISODE, &mut seen, &mut |_, _| {}).unwrap();
    }
    if periods < TICKS {
        // Too few for rare events: only the checker decides.
        return;
    }
    for state in State::ALL {
        assert!(
            seen[0][state as usize] > periods as u64 / 500,
            "{state:?}: {} periods",
            seen[0][state as usize]
        );
    }
    for cause in Cause::ALL {
        let least = if cause == Cause::None {
            0
        } else {
            periods as u64 / 333_333
        };
        assert!(
            seen[1][cause as usize] >= least,
            "{cause:?}: {} times",
            seen[1][cause as usize]
        );
    }
}

#[test]
fn broken_guards_are_caught() {
    type Break = fn(&mut Said, State);
    let broken: [(&str, Break); 11] = [
        ("beyond the window", |said, _| {
            said.paths
                .iter_mut()
                .for_each(|path| *path += 4000.0 * f64::from(u8::from(said.output.torque)))
        }),
        ("goal off its path", |said, _| said.goals[0] += 1),
        ("torque in FAULT", |said, _| {
            said.output.torque |= said.output.state == State::Fault
        }),
        ("no torque while engaged", |said, _| {
            said.output.torque &= said.output.state != State::Engaged
        }),
        ("never holds", |said, _| {
            if said.output.state == State::Hold {
                said.output.state = State::Engaged
            }
        }),
        ("never faults", |said, _| {
            if said.output.state == State::Fault {
                (said.output.state, said.output.torque) = (State::Hold, true)
            }
        }),
        ("engages by itself", |said, _| {
            if said.output.state == State::Ready {
                (said.output.state, said.output.torque) = (State::Engaged, true)
            }
        }),
        ("leaves FAULT by itself", |said, from| {
            if said.output.state == State::Fault && from == State::Fault {
                said.output.state = State::Homed
            }
        }),
        ("too much current", |said, _| {
            said.currents
                .iter_mut()
                .flatten()
                .for_each(|current| *current *= 1.5)
        }),
        ("no cap", |said, _| said.currents.fill(None)),
        ("a step too many", |said, _| {
            said.paths[0] += if said.goals[0] % 7 == 0 { 40.0 } else { 0.0 }
        }),
    ];
    for (name, breaks) in broken {
        let mut breaks = breaks;
        let caught = (0..200)
            .any(|seed| play(104_729 * seed + 3, EPISODE, &mut [[0; 16]; 2], &mut breaks).is_err());
        assert!(caught, "{name} is not caught");
    }
}
