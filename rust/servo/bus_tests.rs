//! The bus on emulated servos: silent, late or damaged answers do not affect the others; invalid
//! ports.

use super::*;
use crate::emulator::pty::Terminal;
use crate::emulator::servo::{RESET, Servo};
use crate::emulator::virtual_port::{FINE, bus, engaged, goals, servos};
use crate::emulator::{Emulator, Faults};
use crate::registers::{FAST_FIRMWARE, X_SERIES, mode};
use crate::serial::{OpenFault, Serial};
use std::thread::sleep;
use std::time::Duration;

#[test]
fn a_silent_servo_does_not_take_the_other_s_answer_with_it() {
    for fast in [false, true] {
        let mut bus = bus(&[1, 2, 3]);
        bus.port().emulator.servos[1].broken.mute = true;
        let (mut data, mut heard) = ([0xAA; 12], [FINE; 3]);
        bus.sync_read(&[1, 2, 3], 132, 4, &mut data, &mut heard, fast)
            .unwrap();
        assert_eq!(heard[0], FINE);
        assert_eq!(heard[1], Err(Fault::Silent));
        // In one packet, nothing follows a silent servo.
        assert_eq!(heard[2], if fast { Err(Fault::Silent) } else { FINE });
        assert_eq!(data[..4], 2000i32.to_le_bytes());
        assert_eq!(data[4..8], [0xAA; 4], "no data are no zeros");
        assert_eq!(bus.counts().silent, if fast { 2 } else { 1 });
    }
}

#[test]
fn old_firmware_answers_by_itself_but_not_in_one_packet() {
    for (version, fast, expected) in [
        (FAST_FIRMWARE, true, FINE),
        (FAST_FIRMWARE - 1, true, Err(Fault::Silent)),
        (FAST_FIRMWARE - 1, false, FINE),
    ] {
        let mut bus = bus(&[1, 2]);
        bus.port().emulator.servos[1].set_firmware(version);
        assert_eq!(bus.ping(2), Ok((1200, version)));
        let (mut data, mut heard) = ([0; 8], [FINE; 2]);
        bus.sync_read(&[1, 2], 132, 4, &mut data, &mut heard, fast)
            .unwrap();
        assert_eq!(heard, [FINE, expected], "{version} {fast}");
    }
}

#[test]
fn all_are_released_at_once_and_two_ids_are_exchanged() {
    let mut bus = engaged(&[1, 2]);
    bus.port().emulator.swap(0, 1);
    let servos = &bus.port().emulator.servos;
    assert_eq!([servos[0].id(), servos[1].id()], [2, 1]);
    bus.release().unwrap();
    bus.port().pass(0.01);
    assert!(!bus.port().emulator.servos.iter().any(Servo::torque));
}

#[test]
fn a_late_answer_is_never_taken_for_the_next_one() {
    let mut bus = bus(&[1]);
    bus.port().emulator.set_faults(Faults {
        slow: 0.003,
        ..Faults::default()
    });
    let mut data = [0; 4];
    assert_eq!(bus.read(1, 132, &mut data), Err(Fault::Silent));
    bus.port().emulator.set_faults(Faults::default());
    // The answer to the position arrives now; it must not be read as the limit.
    assert_eq!(bus.read(1, X_SERIES.max_position.address, &mut data), FINE);
    assert_eq!(i32::from_le_bytes(data), 4095);
}

#[test]
fn refusals_are_reported_by_their_meaning() {
    let mut bus = engaged(&[1]);
    let refused = |error| Err(Fault::Refused(error));
    assert_eq!(
        bus.write(1, X_SERIES.operating_mode.address, &[4]),
        refused(7)
    );
    assert_eq!(
        bus.write(1, X_SERIES.present_position.address, &[0; 4]),
        refused(7)
    );
    assert_eq!(
        bus.write(1, X_SERIES.goal_position.address, &[0; 3]),
        refused(5)
    );
    assert_eq!(
        bus.write(
            1,
            X_SERIES.goal_position.address,
            &2_000_000i32.to_le_bytes()
        ),
        refused(6)
    );
    assert_eq!(
        bus.write(1, X_SERIES.torque_enable.address, &[2]),
        refused(4)
    );
    let text = Fault::Refused(7).to_string();
    assert!(text.contains("read only"), "{text}");
    assert!(Fault::Refused(99).to_string().contains("unknown"));
    bus.port().emulator.servos[0].fail(0x20);
    let mut torque = [9];
    assert_eq!(
        bus.read(1, X_SERIES.torque_enable.address, &mut torque),
        Ok(Answer { alert: true })
    );
    assert_eq!(torque, [0]);
    assert_eq!(
        bus.write(1, X_SERIES.torque_enable.address, &[1]),
        refused(7)
    );
    assert_eq!(bus.reboot(1), Ok(Answer { alert: false }));
    bus.port().pass(RESET + 0.1);
    assert_eq!(bus.write(1, X_SERIES.torque_enable.address, &[1]), FINE);
}

#[test]
fn junk_and_damage_cost_answers_but_never_make_one() {
    let mut bus = engaged(&[1, 2]);
    let faults = Faults {
        junk: 0.2,
        damage: 0.05,
        ..Faults::default()
    };
    bus.port().emulator.set_faults(faults);
    let (mut age, mut worst, mut kept) = ([0; 2], 0, 0);
    for turn in 0..5000 {
        let (mut data, mut heard) = ([0; 8], [FINE; 2]);
        bus.sync_read(&[1, 2], 132, 4, &mut data, &mut heard, false)
            .unwrap();
        for k in 0..2 {
            age[k] = if heard[k].is_ok() { 0 } else { age[k] + 1 };
            kept += u32::from(age[k] <= 3);
            worst = worst.max(age[k]);
            if heard[k].is_ok() {
                assert_eq!(data[4 * k..4 * k + 4], 2000i32.to_le_bytes(), "turn {turn}");
            }
        }
    }
    assert!(
        kept >= 9990 && worst >= 1,
        "{kept} of 10000, {worst} at worst"
    );
    assert!(bus.counts().damaged > 100 && bus.counts().skipped > 1000);
}

#[test]
fn a_pseudo_terminal_is_a_serial_port() {
    let mut terminal = Terminal::open(Emulator::new(servos(&[1, 2]), 1_000_000, 3)).unwrap();
    let path = terminal.path().to_owned();
    let mut bus = Bus::new(
        Serial::open(&path, 1_000_000).unwrap(),
        1_000_000,
        20_000_000,
    );
    assert_eq!(bus.ping(1), Ok((1200, 46)));
    assert_eq!(
        Serial::open(&path, 1_000_000).err(),
        Some(OpenFault::Busy(path.clone()))
    );
    let (mut data, mut heard) = ([0; 54], [FINE; 2]);
    for fast in [false, true] {
        bus.sync_read(&[1, 2], 120, 27, &mut data, &mut heard, fast)
            .unwrap();
        assert_eq!(heard, [FINE; 2]);
    }
    terminal.emulator().servos[0].broken.mute = true;
    assert_eq!(bus.ping(1), Err(Fault::Silent));
    assert_eq!(bus.ping(2), Ok((1200, 46)));
    drop(bus);
    let mut slow = Bus::new(Serial::open(&path, 57_600).unwrap(), 57_600, 20_000_000);
    assert_eq!(
        slow.ping(2),
        Err(Fault::Silent),
        "another rate is not understood"
    );
    terminal.unplug();
    assert_eq!(slow.ping(2), Err(Fault::Port(PortFault::Gone)));
    drop(slow);
    assert_eq!(
        Serial::open(&path, 57_600).err(),
        Some(OpenFault::Missing(path))
    );
    assert_eq!(
        Serial::open("/dev/null", 57_600).err(),
        Some(OpenFault::NoTerminal("/dev/null".into()))
    );
    assert_eq!(
        Serial::open("/tmp", 57_600).err(),
        Some(OpenFault::NoTerminal("/tmp".into()))
    );
}

#[test]
fn a_terminal_that_slept_takes_it_for_no_silence_of_the_master() {
    let terminal = Terminal::open(Emulator::new(servos(&[1]), 1_000_000, 3)).unwrap();
    let serial = Serial::open(terminal.path(), 1_000_000).unwrap();
    let mut bus = Bus::new(serial, 1_000_000, 2_000_000_000);
    for (register, value) in [
        (X_SERIES.operating_mode, mode::CURRENT_BASED_POSITION),
        (X_SERIES.torque_enable, 1),
        (X_SERIES.bus_watchdog, 15),
    ] {
        assert_eq!(bus.write(1, register.address, &[value]), FINE);
    }
    let step = Duration::from_millis(20);
    let held = terminal.emulator();
    for _ in 0..30 {
        goals(&mut bus, &[1], &[2000]);
        sleep(step);
    }
    drop(held);
    let mut watchdog = [0];
    let mut ask = |bus: &mut Bus<Serial>| {
        assert_eq!(
            bus.read(1, X_SERIES.bus_watchdog.address, &mut watchdog),
            FINE
        );
        watchdog[0]
    };
    assert_eq!(ask(&mut bus), 15, "it was spoken to in time");
    sleep(30 * step);
    assert_eq!(ask(&mut bus), 255, "it was not");
}

#[test]
fn unrequested_answers_are_counted_and_late_ones_are_distinguished() {
    let mut bus = bus(&[1, 2]);
    assert_eq!(bus.ping(1), Ok((1200, 46)));
    // Another program on the same wire: its answers are waiting before the next request.
    let mut buffer = [0; LONGEST];
    let foreign = crate::packet::packet(&mut buffer, 1, instruction::WRITE, &[65, 0, 1]).unwrap();
    let now = bus.port().seconds();
    bus.port().emulator.hear(foreign, now);
    bus.port().pass(0.01);
    assert_eq!(bus.ping(2), Ok((1200, 46)));
    assert_eq!((bus.counts().unasked, bus.counts().late), (1, 0));
    // A late answer was requested.
    bus.port().emulator.set_faults(Faults {
        slow: 0.05,
        ..Faults::default()
    });
    assert_eq!(bus.ping(1), Err(Fault::Silent));
    bus.port().emulator.set_faults(Faults::default());
    bus.port().pass(0.1);
    assert_eq!(bus.ping(1), Ok((1200, 46)));
    assert_eq!((bus.counts().unasked, bus.counts().late), (1, 1));
    // Two servos with the same id that answer in sequence.
    let delay = X_SERIES.return_delay.address;
    assert_eq!(bus.write(2, delay, &[0]), FINE);
    bus.port().emulator.servos[1].set_id(1);
    assert_eq!(bus.ping(1), Ok((1200, 46)));
    bus.port().pass(0.01);
    assert_eq!(bus.ping(3), Err(Fault::Silent));
    assert_eq!(bus.counts().unasked, 2);
}

/// A port that stores the sent bytes and gives one answer.
struct Tape {
    sent: Vec<u8>,
    answer: Vec<u8>,
}

impl Port for Tape {
    fn now(&self) -> u64 {
        0
    }

    fn wait(&mut self, _until: u64) {}

    fn send(&mut self, bytes: &[u8], _until: u64) -> Result<(), PortFault> {
        self.sent.extend(bytes);
        Ok(())
    }

    fn receive(&mut self, into: &mut [u8], _until: u64) -> Result<usize, PortFault> {
        if self.sent.is_empty() {
            return Ok(0);
        }
        let count = self.answer.len();
        into[..count].copy_from_slice(&self.answer);
        self.answer.clear();
        Ok(count)
    }

    fn discard(&mut self) -> Result<(), PortFault> {
        Ok(())
    }
}

fn bytes(hex: &str) -> Vec<u8> {
    let byte = |pair| u8::from_str_radix(pair, 16).unwrap();
    hex.split(' ').map(byte).collect()
}

/// The same bytes as in tests/robot/test_sdk_packets.py, where the official SDK sends the packets
/// and reads the answers.
#[test]
fn what_the_loop_sends_and_hears_is_the_sdk_s() {
    let bus = |answer: &str| {
        let answer = bytes(answer);
        Bus::new(
            Tape {
                sent: vec![],
                answer,
            },
            1_000_000,
            1,
        )
    };
    let answers =
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0 FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE";
    let together = "FF FF FD 00 FE 11 00 55 00 01 A6 00 00 00 74 3B 00 02 1F 08 00 00 1C 36";
    for (fast, answer, packet) in [
        (
            false,
            answers,
            "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
        ),
        (
            true,
            together,
            "FF FF FD 00 FE 09 00 8A 84 00 04 00 01 02 4D 72",
        ),
    ] {
        let mut bus = bus(answer);
        let (mut data, mut heard) = ([0; 8], [Err(Fault::Silent); 2]);
        bus.sync_read(&[1, 2], 132, 4, &mut data, &mut heard, fast)
            .unwrap();
        assert_eq!(bus.port().sent, bytes(packet));
        assert_eq!(heard, [FINE; 2]);
        assert_eq!(data, [0xA6, 0, 0, 0, 0x1F, 8, 0, 0]);
    }
    let mut bus = bus("00");
    bus.sync_write(&[1, 2], 116, 4, &[0x96, 0, 0, 0, 0xAA, 0, 0, 0])
        .unwrap();
    let packet = "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87";
    assert_eq!(bus.port().sent, bytes(packet));
}

/// A port in simulated time, whose bytes arrive at given times, ns.
struct Arrivals {
    now: u64,
    due: Vec<(u64, Vec<u8>)>,
}

impl Port for Arrivals {
    fn now(&self) -> u64 {
        self.now
    }

    fn wait(&mut self, until: u64) {
        self.now = self.now.max(until);
    }

    fn send(&mut self, _bytes: &[u8], _until: u64) -> Result<(), PortFault> {
        Ok(())
    }

    fn receive(&mut self, into: &mut [u8], until: u64) -> Result<usize, PortFault> {
        let next = self.due.first().is_some_and(|(at, _)| *at <= until);
        if !next {
            self.now = until;
            return Ok(0);
        }
        let (at, bytes) = self.due.remove(0);
        self.now = self.now.max(at);
        into[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn discard(&mut self) -> Result<(), PortFault> {
        Ok(())
    }
}

/// The time of a scan in s, and the ids found. An adapter delivers its bytes every 16 ms.
fn scanned(baud: u32, ids: &[u8]) -> (f64, Vec<u8>) {
    let byte = 10_000_000_000 / u64::from(baud);
    let (mut due, mut busy) = (Vec::new(), 0);
    for &id in ids {
        let mut buffer = [0; LONGEST];
        let mut packet = Packet::new(&mut buffer, id, instruction::STATUS);
        packet.bytes(&[0, 0xB0, 0x04, 46]);
        let bytes = packet.finish().unwrap();
        busy += bytes.len() as u64 * byte;
        let over = 11 * byte + u64::from(id) * PAUSE + busy;
        due.push((over.next_multiple_of(16_000_000), bytes.to_vec()));
    }
    let mut bus = Bus::new(Arrivals { now: 0, due }, baud, SLACK);
    let mut found = Vec::new();
    bus.ping_all(|id, _, _| found.push(id)).unwrap();
    (bus.port().now as f64 * 1e-9, found)
}

#[test]
fn a_scan_waits_for_every_servo_and_no_longer() {
    let every: Vec<u8> = (0..=HIGHEST_ID).collect();
    for baud in [9_600, 57_600, 1_000_000] {
        assert_eq!(scanned(baud, &every).1, every, "{baud}");
        assert_eq!(scanned(baud, &[252]).1, [252], "{baud}");
        let (empty, found) = scanned(baud, &[]);
        assert!(found.is_empty() && empty < 0.82, "{baud}: {empty} s");
        let due = (0..u64::MAX).step_by(1_000_000).take(100_000);
        let noise = due
            .map(|at| (at, vec![0x55; baud as usize / 10_000]))
            .collect();
        let mut bus = Bus::new(Arrivals { now: 0, due: noise }, baud, SLACK);
        bus.ping_all(|_, _, _| ()).unwrap();
        let most = 0.82 + 254.0 * longest(3) as f64 * 10.0 / f64::from(baud);
        assert!(bus.port().now as f64 * 1e-9 < most, "{baud}");
    }
}
