//! A heartbeat from another computer over UDP: without it, the emergency stop is pressed.
//!
//! A beat is BEAT bytes, little-endian: mark `SMB1`, flags (u8, 1: pressed), session (16 bytes),
//! sequence number (u64), the sender's clock (u64 ns) and HMAC-SHA256 of all that under a shared
//! key. This end defines the session. While there is no heartbeat, a sender that signs correctly
//! under another session receives the current one (mark `SMC1`, session, HMAC). Sequence numbers
//! must increase within a session. After a stop there is a new session, so recorded or queued beats
//! are invalid. The age of a beat is the time since its arrival, plus its delay relative to the
//! fastest beat; clocks need not agree. All other datagrams are dropped. Its other end is
//! `softmap_edge/robot/control/heartbeat.py`; both are pinned by tests/robot/test_emergency.py.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};

use hmac::{Hmac, Mac};
use rustix::rand::{GetRandomFlags, getrandom};
use sha2::Sha256;

const MARK: [u8; 4] = *b"SMB1";
const OFFER_MARK: [u8; 4] = *b"SMC1";
const SESSION: usize = 16;
const TAG: usize = 32;
const BODY: usize = 4 + 1 + SESSION + 8 + 8;
/// Bytes of a beat.
pub const BEAT: usize = BODY + TAG;
/// Bytes of an offer.
pub const OFFER: usize = 4 + SESSION + TAG;
const PRESSED: u8 = 1;
/// Most datagrams read per period, so a flood cannot delay it.
const MOST_AT_ONCE: usize = 16;
/// Inverse of the largest relative drift of two clocks.
const DRIFT: u64 = 10_000;

/// The newest beat: its number, arrival in ns, delay relative to the fastest, and its flag.
#[derive(Clone, Copy)]
struct Beat {
    sequence: u64,
    at: u64,
    late: u64,
    pressed: bool,
}

/// The receiving end.
pub struct Heartbeat {
    socket: UdpSocket,
    keyed: Hmac<Sha256>,
    timeout: u64,
    session: [u8; SESSION],
    last: Option<Beat>,
    /// The minimum of arrival minus the sender's clock, ns, and its time.
    quickest: Option<(i64, u64)>,
}

impl Heartbeat {
    /// Listen at `host`:`port` for beats signed with `key`, at least one per `timeout` s, or return
    /// the reason for the failure.
    pub fn open(host: &str, port: u16, key: &[u8], timeout: f64) -> Result<Heartbeat, String> {
        let failed = |fault: &dyn std::fmt::Display| {
            format!(
                "the heartbeat cannot be listened for at {host}:{port} ({fault}); give a free \
                port of this computer"
            )
        };
        let socket = UdpSocket::bind((host, port)).map_err(|fault| failed(&fault))?;
        socket
            .set_nonblocking(true)
            .map_err(|fault| failed(&fault))?;
        let mut session = [0; SESSION];
        getrandom(&mut session, GetRandomFlags::empty()).map_err(|fault| failed(&fault))?;
        let keyed = Hmac::new_from_slice(key).map_err(|fault| failed(&fault))?;
        Ok(Heartbeat {
            socket,
            keyed,
            timeout: (timeout * 1e9) as u64,
            session,
            last: None,
            quickest: None,
        })
    }

    /// Whether the heartbeat is missing, or reports a pressed stop, at `now` (ns).
    pub fn pressed(&mut self, now: u64) -> bool {
        let (mut datagram, mut pressed) = ([0; BEAT + 1], false);
        for _ in 0..MOST_AT_ONCE {
            match self.socket.recv_from(&mut datagram) {
                Ok((size, from)) => pressed |= self.take(&datagram[..size], from, now),
                // An error returned for an offer does not end the queue.
                Err(fault) if fault.kind() != ErrorKind::WouldBlock => {}
                Err(_) => break,
            }
        }
        let Some(beat) = self.last else { return true };
        if now.saturating_sub(beat.at).saturating_add(beat.late) > self.timeout {
            self.renew();
            return true;
        }
        pressed || beat.pressed
    }

    /// Process a datagram; return whether it is a beat with the stop pressed.
    fn take(&mut self, datagram: &[u8], from: SocketAddr, now: u64) -> bool {
        let Some((body, tag)) = datagram.split_at_checked(BODY) else {
            return false;
        };
        let signed = self
            .keyed
            .clone()
            .chain_update(body)
            .verify_slice(tag)
            .is_ok();
        if !signed || body[..4] != MARK || body[4] & !PRESSED != 0 {
            return false;
        }
        let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|k| body[at + k]));
        let (sequence, clock) = (number(5 + SESSION), number(13 + SESSION));
        if body[5..5 + SESSION] != self.session {
            if self.last.is_none() {
                self.offer(from);
            }
            return false;
        }
        if self.last.is_some_and(|beat| sequence <= beat.sequence) {
            return false;
        }
        let pressed = body[4] & PRESSED != 0;
        let late = self.lateness(now, clock);
        self.last = Some(Beat {
            sequence,
            at: now,
            late,
            pressed,
        });
        pressed
    }

    /// Delay of a beat relative to the fastest, ns.
    fn lateness(&mut self, now: u64, clock: u64) -> u64 {
        let apart = now.wrapping_sub(clock) as i64;
        let known = self.quickest.map_or(apart, |(least, when)| {
            least.saturating_add((now.saturating_sub(when) / DRIFT) as i64)
        });
        let least = known.min(apart);
        self.quickest = Some((least, now));
        apart.saturating_sub(least).max(0) as u64
    }

    /// Send the session to the sender with the key; after a failure, retry with the next beat.
    fn offer(&self, to: SocketAddr) {
        let mut datagram = [0; OFFER];
        datagram[..4].copy_from_slice(&OFFER_MARK);
        datagram[4..4 + SESSION].copy_from_slice(&self.session);
        let (body, tag) = datagram.split_at_mut(4 + SESSION);
        tag.copy_from_slice(
            &self
                .keyed
                .clone()
                .chain_update(body)
                .finalize()
                .into_bytes(),
        );
        let _ = self.socket.send_to(&datagram, to);
    }

    /// Beats sent before the stop are invalid.
    fn renew(&mut self) {
        (self.last, self.quickest) = (None, None);
        for byte in self.session.iter_mut().rev() {
            *byte = byte.wrapping_add(1);
            if *byte != 0 {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocations::allocations;
    use std::time::Duration;

    const KEY: [u8; 32] = [7; 32];
    const MS: u64 = 1_000_000;

    struct Sender {
        socket: UdpSocket,
        session: [u8; SESSION],
    }

    impl Sender {
        fn to(heart: &Heartbeat) -> Sender {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.connect(heart.socket.local_addr().unwrap()).unwrap();
            socket
                .set_read_timeout(Some(Duration::from_secs(5)))
                .unwrap();
            Sender {
                socket,
                session: [0; SESSION],
            }
        }

        fn beat(&self, key: &[u8], sequence: u64, clock: u64, flags: u8) -> Vec<u8> {
            let mut beat = MARK.to_vec();
            beat.push(flags);
            beat.extend(self.session);
            beat.extend(sequence.to_le_bytes());
            beat.extend(clock.to_le_bytes());
            let mut mac = Hmac::<Sha256>::new_from_slice(key).unwrap();
            mac.update(&beat);
            beat.extend(mac.finalize().into_bytes());
            self.socket.send(&beat).unwrap();
            beat
        }

        /// Request a session and use it.
        fn meet(&mut self, heart: &mut Heartbeat, now: u64) {
            self.session = [0; SESSION];
            self.beat(&KEY, 1, 0, 0);
            let mut offer = [0; OFFER + 1];
            for _ in 0..1000 {
                assert!(heart.pressed(now), "a session that is not ours");
                self.socket.set_nonblocking(true).unwrap();
                if self.socket.recv(&mut offer).is_ok_and(|size| size == OFFER) {
                    self.session.copy_from_slice(&offer[4..4 + SESSION]);
                    return;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            panic!("no offer");
        }
    }

    /// Poll until the sent data have passed loopback.
    fn released(heart: &mut Heartbeat, now: u64) -> bool {
        (0..200).any(|_| {
            let pressed = heart.pressed(now);
            if pressed {
                std::thread::sleep(Duration::from_millis(1));
            }
            !pressed
        })
    }

    fn heart() -> Heartbeat {
        Heartbeat::open("127.0.0.1", 0, &KEY, 0.1).unwrap()
    }

    #[test]
    fn it_is_pressed_until_it_beats_and_again_when_it_stops() {
        let mut heart = heart();
        assert!(heart.pressed(MS), "nothing was ever heard");
        let mut sender = Sender::to(&heart);
        sender.meet(&mut heart, 2 * MS);
        sender.beat(&KEY, 2, 3 * MS, 0);
        assert!(released(&mut heart, 3 * MS));
        assert!(!heart.pressed(103 * MS) && heart.pressed(104 * MS));
        // The old session is invalid: there is a new one.
        sender.beat(&KEY, 3, 104 * MS, 0);
        std::thread::sleep(Duration::from_millis(5));
        assert!(heart.pressed(104 * MS));
        sender.meet(&mut heart, 105 * MS);
        sender.beat(&KEY, 1, 106 * MS, 0);
        assert!(released(&mut heart, 106 * MS));
    }

    #[test]
    fn pressed_in_one_beat_of_a_period_is_pressed() {
        let mut heart = heart();
        let mut sender = Sender::to(&heart);
        sender.meet(&mut heart, MS);
        sender.beat(&KEY, 2, MS, 0);
        assert!(released(&mut heart, MS));
        sender.beat(&KEY, 3, 2 * MS, PRESSED);
        sender.beat(&KEY, 4, 2 * MS, 0);
        let seen = (0..200).any(|_| {
            std::thread::sleep(Duration::from_millis(1));
            heart.pressed(2 * MS)
        });
        assert!(seen);
        assert!(released(&mut heart, 2 * MS), "and released by the next");
    }

    #[test]
    fn nothing_that_is_forged_recorded_or_late_keeps_it_alive() {
        let mut heart = heart();
        let mut sender = Sender::to(&heart);
        sender.meet(&mut heart, MS);
        let recorded = sender.beat(&KEY, 5, MS, 0);
        assert!(released(&mut heart, MS));
        let mut changed = recorded.clone();
        changed[BODY - 20] ^= 1;
        for bytes in [
            &recorded[..],
            &changed,
            &recorded[..BEAT - 1],
            &[0; 300],
            b"",
        ] {
            sender.socket.send(bytes).unwrap();
        }
        sender.beat(&[8; 32], 6, 50 * MS, 0); // of another key
        sender.beat(&KEY, 4, 50 * MS, 0); // an old number
        sender.beat(&KEY, 6, 50 * MS, 2); // an unknown flag
        std::thread::sleep(Duration::from_millis(10));
        assert!(!heart.pressed(60 * MS) && heart.pressed(102 * MS));

        sender.meet(&mut heart, 200 * MS);
        sender.beat(&KEY, 2, 200 * MS, 0);
        assert!(released(&mut heart, 200 * MS));
        sender.beat(&KEY, 3, 210 * MS, 0); // queued for 150 ms
        std::thread::sleep(Duration::from_millis(5));
        assert!(heart.pressed(360 * MS));
    }

    #[test]
    fn a_beat_and_an_offer_allocate_nothing() {
        let mut heart = heart();
        let mut sender = Sender::to(&heart);
        sender.beat(&KEY, 1, MS, 0);
        std::thread::sleep(Duration::from_millis(5));
        assert_eq!(allocations(|| assert!(heart.pressed(MS))), 0);
        sender.meet(&mut heart, MS);
        sender.beat(&KEY, 2, MS, 0);
        std::thread::sleep(Duration::from_millis(5));
        assert_eq!(
            allocations(|| assert!(!heart.pressed(MS) && heart.pressed(900 * MS))),
            0
        );
    }

    #[test]
    fn a_port_that_is_taken_is_refused_with_a_reason() {
        let first = heart();
        let port = first.socket.local_addr().unwrap().port();
        let said = Heartbeat::open("127.0.0.1", port, &KEY, 0.1).err().unwrap();
        assert!(said.contains(&format!("at 127.0.0.1:{port}")) && said.contains("free port"));
    }
}
