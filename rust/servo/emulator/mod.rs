//! A bus of emulated servos: bytes in, bytes out at their wire times, faults on command.
//!
//! It uses the packets of `packet.rs` with real timing: ten bits per byte at the servos' baud rate,
//! return delay, answers of several servos in sequence. Time is an input, so tests run as fast as
//! possible and the pseudo-terminal (`pty.rs`) in real time. It can produce every fault of
//! docs/reference/safety.md without breaking a servo.

mod motor;
mod pace;
pub mod pty;
pub mod servo;
pub mod simulated;
mod table;
#[cfg(test)]
pub(crate) mod virtual_port;

use std::collections::VecDeque;

use crate::crc::crc;
use crate::decoder::Decoder;
use crate::packet::{BROADCAST, CLEAR_TURNS, HEADER, LONGEST, Packet, instruction};
use crate::registers::{BAUD_RATES, FAST_FIRMWARE};
use servo::Servo;
use table::refusal;

/// Faults of the wire on answers; probabilities from 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Faults {
    /// An answer is lost.
    pub drop: f64,
    /// A byte of an answer is changed.
    pub damage: f64,
    /// Up to eight random bytes come before an answer.
    pub junk: f64,
    /// Additional delay of each answer in the adapter, s.
    pub slow: f64,
    /// No power: no answer, and a reset when power returns.
    pub unpowered: bool,
}

/// Servos on a wire.
#[derive(Debug, Clone)]
pub struct Emulator {
    pub servos: Vec<Servo>,
    faults: Faults,
    /// A register, and the number of its next sync writes that are lost.
    loses: (u16, usize),
    decoder: Decoder,
    /// The master's baud rate.
    baud: u32,
    /// Answers and their completion times, s.
    answers: VecDeque<(f64, Vec<u8>)>,
    free: f64,
    seed: u64,
}

impl Emulator {
    /// Servos at `baud`; faults are drawn from `seed`.
    pub fn new(servos: Vec<Servo>, baud: u32, seed: u64) -> Emulator {
        Emulator {
            servos,
            faults: Faults::default(),
            loses: (0, 0),
            decoder: Decoder::default(),
            baud,
            answers: VecDeque::new(),
            free: 0.0,
            seed: seed.wrapping_mul(2).wrapping_add(1),
        }
    }

    /// Set another baud rate of the master.
    pub fn set_baud(&mut self, baud: u32) {
        self.baud = baud;
    }

    pub fn faults(&self) -> Faults {
        self.faults
    }

    pub fn set_faults(&mut self, faults: Faults) {
        if self.faults.unpowered && !faults.unpowered {
            self.servos.iter_mut().for_each(Servo::boot);
        }
        self.faults = faults;
    }

    /// Lose the next `count` sync writes at `address`: no servo receives them.
    pub fn lose(&mut self, address: u16, count: usize) {
        self.loses = (address, count);
    }

    /// Exchange the ids of two servos.
    pub fn swap(&mut self, one: usize, other: usize) {
        let (first, second) = (self.servos[one].id(), self.servos[other].id());
        self.servos[one].set_id(second);
        self.servos[other].set_id(first);
    }

    /// Clear all faults and restart the servos.
    pub fn mend(&mut self) {
        (self.faults, self.loses) = (Faults::default(), (0, 0));
        self.answers.clear();
        self.servos.iter_mut().for_each(Servo::mend);
    }

    /// Bytes that the master sent at `now` s.
    pub fn hear(&mut self, bytes: &[u8], now: f64) {
        self.decoder.push(bytes);
        let wire = bytes.len() as f64 * 10.0 / f64::from(self.baud);
        self.free = self.free.max(now + wire);
        self.run(now);
        while let Some(packet) = self.decoder.next(LONGEST) {
            let (id, asked, parameters) =
                (packet.id, packet.instruction, packet.parameters.to_vec());
            let (address, left) = self.loses;
            let lost = left > 0
                && asked == instruction::SYNC_WRITE
                && parameters.starts_with(&address.to_le_bytes());
            self.loses.1 -= usize::from(lost);
            if !self.faults.unpowered && !lost {
                self.obey(id, asked, &parameters);
            }
        }
    }

    /// The next bytes that are complete by `now` s.
    pub fn speak(&mut self, now: f64) -> Option<Vec<u8>> {
        match self.answers.front() {
            Some((due, _)) if *due <= now => self.answers.pop_front().map(|(_, bytes)| bytes),
            _ => None,
        }
    }

    /// Completion time of the next bytes, s.
    pub fn due(&self) -> Option<f64> {
        self.answers.front().map(|(due, _)| *due)
    }

    /// Let the servos move until `now` s.
    pub fn run(&mut self, now: f64) {
        let dead = self.faults.unpowered;
        for servo in &mut self.servos {
            if dead && servo.torque() {
                servo.boot();
            }
            servo.run(now);
        }
    }

    /// The stepping program slept for `time` s: messages of the master are still unread, and its
    /// silence does not count.
    pub fn excuse(&mut self, time: f64) {
        self.servos.iter_mut().for_each(|servo| servo.excuse(time));
    }

    fn obey(&mut self, id: u8, asked: u8, parameters: &[u8]) {
        let baud = self.baud;
        let hears = |servo: &Servo| servo.awake() && BAUD_RATES[servo.baud()] == baud;
        self.servos
            .iter_mut()
            .filter(|servo| hears(servo))
            .for_each(Servo::feed);
        let word = |at: usize| {
            let bytes = parameters.get(at..at + 2)?;
            Some(u16::from_le_bytes([bytes[0], bytes[1]]))
        };
        let (first, second) = (word(0).unwrap_or(0), word(2).unwrap_or(0));
        let rest = |from: usize| parameters.get(from..).unwrap_or(&[]);
        match asked {
            instruction::SYNC_WRITE => {
                for one in rest(4).chunks_exact(usize::from(second) + 1) {
                    self.each(one[0], hears, |servo| servo.write(first, &one[1..]).is_ok());
                }
            }
            instruction::SYNC_READ => {
                for one in rest(4) {
                    self.answer(*one, asked, hears, |servo| servo.read(first, second));
                }
            }
            instruction::FAST_SYNC_READ => self.answer_fast(rest(4), first, second, hears),
            instruction::BULK_READ => {
                for one in parameters.chunks_exact(5) {
                    let (address, size) = ([one[1], one[2]], [one[3], one[4]]);
                    let (address, size) = (u16::from_le_bytes(address), u16::from_le_bytes(size));
                    self.answer(one[0], asked, hears, |servo| servo.read(address, size));
                }
            }
            instruction::BULK_WRITE => {
                let mut left = parameters;
                while left.len() >= 5 {
                    let (address, size) = (
                        u16::from_le_bytes([left[1], left[2]]),
                        u16::from_le_bytes([left[3], left[4]]),
                    );
                    let Some(data) = left.get(5..5 + usize::from(size)) else {
                        break;
                    };
                    self.each(left[0], hears, |servo| servo.write(address, data).is_ok());
                    left = &left[5 + usize::from(size)..];
                }
            }
            instruction::STATUS => {}
            _ if id == BROADCAST => {
                let mut ids: Vec<u8> = self.servos.iter().map(Servo::id).collect();
                ids.sort_unstable();
                ids.dedup();
                if asked == instruction::PING {
                    for one in ids {
                        self.answer(one, asked, hears, |servo| servo.read(0, 7).map(firmware));
                    }
                } else {
                    for servo in self.servos.iter_mut().filter(|servo| hears(servo)) {
                        // A request to all servos is not answered.
                        let _ = single(servo, asked, parameters);
                    }
                }
            }
            _ => self.answer(id, asked, hears, |servo| single(servo, asked, parameters)),
        }
    }

    /// Apply a request to each servo that obeys `id`, without an answer.
    fn each(
        &mut self,
        id: u8,
        hears: impl Fn(&Servo) -> bool,
        mut act: impl FnMut(&mut Servo) -> bool,
    ) {
        for servo in self
            .servos
            .iter_mut()
            .filter(|servo| servo.obeys(id) && hears(servo))
        {
            act(servo);
        }
    }

    /// Apply a request to each servo that obeys `id`; those with this id answer. Answers of two
    /// servos with one id overlap, unless one begins after the end of the other.
    fn answer(
        &mut self,
        id: u8,
        asked: u8,
        hears: impl Fn(&Servo) -> bool,
        mut act: impl FnMut(&mut Servo) -> Result<Vec<u8>, u8>,
    ) {
        let mut spoken: Vec<(f64, Vec<u8>)> = vec![];
        for servo in self
            .servos
            .iter_mut()
            .filter(|servo| servo.obeys(id) && hears(servo))
        {
            let delay = servo.return_delay();
            // Read before: a reset changes the answer.
            let answers = servo.id() == id && servo.answers(asked);
            let done = act(servo);
            if !answers {
                continue;
            }
            let (error, data) = match &done {
                Ok(data) => (0, &data[..]),
                Err(error) => (*error, &[][..]),
            };
            let mut buffer = [0; LONGEST];
            let mut packet = Packet::new(&mut buffer, id, instruction::STATUS);
            packet.byte(error | servo.alert());
            packet.bytes(data);
            let Ok(bytes) = packet.finish() else { continue };
            spoken.push((delay, bytes.to_vec()));
        }
        self.say_together(spoken);
    }

    /// Answers of one id, each begun after its delay: overlapping answers are merged, some bytes
    /// apart.
    fn say_together(&mut self, mut spoken: Vec<(f64, Vec<u8>)>) {
        spoken.sort_by(|a, b| a.0.total_cmp(&b.0));
        let byte = 10.0 / f64::from(self.baud);
        let mut last: Option<(f64, Vec<u8>)> = None;
        let mut ended = 0.0;
        for (delay, bytes) in spoken {
            last = Some(match last.take() {
                None => (delay, bytes),
                Some((begin, other)) => {
                    let apart = ((delay - begin) / byte) as usize;
                    if apart < other.len() {
                        (begin, laid_over(&other, &bytes, apart + 1))
                    } else {
                        let end = begin + other.len() as f64 * byte;
                        self.say(other, begin - ended);
                        ended = end;
                        (delay, bytes)
                    }
                }
            });
        }
        if let Some((begin, bytes)) = last {
            self.say(bytes, begin - ended);
        }
    }

    /// One packet of all servos; it ends at a silent servo, or one with too old firmware.
    fn answer_fast(&mut self, ids: &[u8], address: u16, size: u16, hears: impl Fn(&Servo) -> bool) {
        let length = ids.len() * (usize::from(size) + 4) + 1;
        let mut bytes = HEADER.to_vec();
        bytes.push(BROADCAST);
        bytes.extend((length as u16).to_le_bytes());
        bytes.push(instruction::STATUS);
        let empty = bytes.len();
        let mut delay = 0.0;
        for id in ids {
            let Some(servo) = self.servos.iter().find(|servo| {
                servo.id() == *id
                    && hears(servo)
                    && servo.firmware() >= FAST_FIRMWARE
                    && servo.answers(instruction::FAST_SYNC_READ)
            }) else {
                break;
            };
            let Ok(data) = servo.read(address, size) else {
                break;
            };
            delay = servo.return_delay();
            bytes.push(servo.alert());
            bytes.push(*id);
            bytes.extend(data);
            bytes.extend(crc(0, &bytes).to_le_bytes());
        }
        if bytes.len() > empty {
            self.say(bytes, delay);
        }
    }

    fn say(&mut self, mut bytes: Vec<u8>, delay: f64) {
        if self.chance(self.faults.damage) {
            let place = self.below(bytes.len());
            bytes[place] ^= 1 << self.below(8);
        }
        if self.chance(self.faults.junk) {
            let junk: Vec<u8> = (0..=self.below(8)).map(|_| self.below(256) as u8).collect();
            bytes.splice(0..0, junk);
        }
        let lost = self.chance(self.faults.drop);
        self.free += delay + bytes.len() as f64 * 10.0 / f64::from(self.baud);
        if !lost {
            self.answers
                .push_back((self.free + self.faults.slow, bytes));
        }
    }

    fn chance(&mut self, share: f64) -> bool {
        share > 0.0 && (self.below(1 << 30) as f64) < share * f64::from(1 << 30)
    }

    /// A number below `count`, from a linear congruence (Knuth, TAOCP 2, 3.3.4).
    fn below(&mut self, count: usize) -> usize {
        self.seed = self
            .seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.seed >> 33) as usize * count) >> 31
    }
}

/// Two answers on one wire, the second begun some bytes later: a bit is 1 only where it is 1 in
/// both.
fn laid_over(first: &[u8], second: &[u8], late: usize) -> Vec<u8> {
    let at = |bytes: &[u8], k: Option<usize>| k.and_then(|k| bytes.get(k).copied()).unwrap_or(0xFF);
    let length = first.len().max(second.len() + late);
    let both = |k: usize| at(first, Some(k)) & at(second, k.checked_sub(late));
    (0..length).map(both).collect()
}

/// The reaction of one servo to its packet.
fn single(servo: &mut Servo, asked: u8, parameters: &[u8]) -> Result<Vec<u8>, u8> {
    let word = |at: usize| {
        parameters
            .get(at..at + 2)
            .map(|bytes| u16::from_le_bytes([bytes[0], bytes[1]]))
    };
    let address = || word(0).ok_or(refusal::LENGTH);
    let data = parameters.get(2..).unwrap_or(&[]);
    match asked {
        instruction::PING => servo.read(0, 7).map(firmware),
        instruction::READ => servo.read(address()?, word(2).ok_or(refusal::LENGTH)?),
        instruction::WRITE => servo.write(address()?, data).map(|()| vec![]),
        instruction::REG_WRITE => {
            servo.register_write(address()?, data);
            Ok(vec![])
        }
        instruction::ACTION => {
            servo.action();
            Ok(vec![])
        }
        instruction::REBOOT => {
            servo.boot();
            Ok(vec![])
        }
        instruction::CLEAR if parameters == CLEAR_TURNS => servo.clear().map(|()| vec![]),
        _ => Err(refusal::INSTRUCTION),
    }
}

/// Model number and firmware of the first registers.
fn firmware(registers: Vec<u8>) -> Vec<u8> {
    vec![registers[0], registers[1], registers[6]]
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
