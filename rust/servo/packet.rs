//! Packets of Dynamixel Protocol 2.0, written into the caller's buffer.
//!
//!   FF FF FD 00 · id · length (2) · instruction · parameters … · CRC (2)        length = what
//!     follows it, low byte first
//!
//! After FF FF FD in instruction and parameters, another FD is inserted (byte stuffing), so no
//! packet contains a header; length and CRC include it. Source: ROBOTIS, "DYNAMIXEL Protocol 2.0".
//! Pinned by the manual's packets below and by the official SDK (tests/robot/test_sdk_packets.py).

use crate::crc::crc;

pub const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// Bytes before the instruction.
pub const HEAD: usize = 7;
/// The broadcast id.
pub const BROADCAST: u8 = 0xFE;
/// The highest id of a servo.
pub const HIGHEST_ID: u8 = 252;
/// Longest packet, bytes; the official SDK has the same limit.
pub const LONGEST: usize = 1024;

/// The instruction of a packet, or `STATUS` for an answer.
pub mod instruction {
    pub const PING: u8 = 0x01;
    pub const READ: u8 = 0x02;
    pub const WRITE: u8 = 0x03;
    pub const REG_WRITE: u8 = 0x04;
    pub const ACTION: u8 = 0x05;
    pub const FACTORY_RESET: u8 = 0x06;
    pub const REBOOT: u8 = 0x08;
    pub const CLEAR: u8 = 0x10;
    pub const STATUS: u8 = 0x55;
    pub const SYNC_READ: u8 = 0x82;
    pub const SYNC_WRITE: u8 = 0x83;
    pub const FAST_SYNC_READ: u8 = 0x8A;
    pub const BULK_READ: u8 = 0x92;
    pub const BULK_WRITE: u8 = 0x93;
}

/// Parameters of `CLEAR` that set the present position back to within one turn; the last four
/// protect against accidents.
pub const CLEAR_TURNS: [u8; 5] = [0x01, 0x44, 0x58, 0x4C, 0x22];

/// The buffer is too small for the packet, or the packet longer than `LONGEST`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the packet does not fit into {0} bytes; send fewer servos or registers at a time")]
pub struct Full(pub usize);

/// A packet under construction.
#[derive(Debug)]
pub struct Packet<'a> {
    buffer: &'a mut [u8],
    used: usize,
    /// The last two bytes before stuffing.
    last: [u8; 2],
    full: bool,
}

impl<'a> Packet<'a> {
    /// Begin a packet for `id`.
    pub fn new(buffer: &'a mut [u8], id: u8, instruction: u8) -> Packet<'a> {
        let most = buffer.len().min(LONGEST);
        let buffer = &mut buffer[..most];
        let full = most < HEAD;
        if !full {
            buffer[..4].copy_from_slice(&HEADER);
            buffer[4] = id;
        }
        let mut packet = Packet {
            buffer,
            used: HEAD,
            last: [0, 0],
            full,
        };
        packet.byte(instruction);
        packet
    }

    /// Add one byte, with stuffing if needed.
    pub fn byte(&mut self, byte: u8) {
        self.put(byte);
        if self.last == [0xFF, 0xFF] && byte == 0xFD {
            self.put(0xFD);
        }
        self.last = [self.last[1], byte];
    }

    /// Add two bytes, the low one first.
    pub fn word(&mut self, word: u16) {
        self.bytes(&word.to_le_bytes());
    }

    /// Add bytes without stuffing.
    pub fn bytes(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.byte(*byte));
    }

    /// Close the packet with length and checksum; return the bytes to send.
    pub fn finish(mut self) -> Result<&'a [u8], Full> {
        let length = self.used + 2 - HEAD;
        if !self.full {
            self.buffer[5..HEAD].copy_from_slice(&(length as u16).to_le_bytes());
            let sum = crc(0, &self.buffer[..self.used]);
            sum.to_le_bytes().iter().for_each(|byte| self.put(*byte));
        }
        if self.full {
            return Err(Full(self.buffer.len()));
        }
        Ok(&self.buffer[..self.used])
    }

    fn put(&mut self, byte: u8) {
        match self.buffer.get_mut(self.used) {
            Some(place) => {
                *place = byte;
                self.used += 1;
            }
            None => self.full = true,
        }
    }
}

/// Write a complete packet with `parameters`.
pub fn packet<'a>(
    buffer: &'a mut [u8],
    id: u8,
    instruction: u8,
    parameters: &[u8],
) -> Result<&'a [u8], Full> {
    let mut packet = Packet::new(buffer, id, instruction);
    packet.bytes(parameters);
    packet.finish()
}

#[cfg(test)]
mod tests {
    use super::instruction::*;
    use super::*;

    /// The examples of the protocol manual: id, instruction, parameters, and the bytes after FF FF
    /// FD 00.
    pub(crate) const MANUAL: &[(u8, u8, &[u8], &[u8])] = &[
        (1, PING, &[], &[0x01, 0x03, 0x00, 0x01, 0x19, 0x4E]),
        (BROADCAST, PING, &[], &[0xFE, 0x03, 0x00, 0x01, 0x31, 0x42]),
        (
            1,
            STATUS,
            &[0, 0x06, 0x04, 0x26],
            &[0x01, 0x07, 0x00, 0x55, 0x00, 0x06, 0x04, 0x26, 0x65, 0x5D],
        ),
        (
            2,
            STATUS,
            &[0, 0x06, 0x04, 0x26],
            &[0x02, 0x07, 0x00, 0x55, 0x00, 0x06, 0x04, 0x26, 0x6F, 0x6D],
        ),
        (
            1,
            READ,
            &[0x84, 0, 4, 0],
            &[0x01, 0x07, 0x00, 0x02, 0x84, 0x00, 0x04, 0x00, 0x1D, 0x15],
        ),
        (
            1,
            STATUS,
            &[0, 0xA6, 0, 0, 0],
            &[
                0x01, 0x08, 0x00, 0x55, 0x00, 0xA6, 0x00, 0x00, 0x00, 0x8C, 0xC0,
            ],
        ),
        (
            1,
            WRITE,
            &[0x74, 0, 0, 2, 0, 0],
            &[
                0x01, 0x09, 0x00, 0x03, 0x74, 0x00, 0x00, 0x02, 0x00, 0x00, 0xCA, 0x89,
            ],
        ),
        (1, STATUS, &[0], &[0x01, 0x04, 0x00, 0x55, 0x00, 0xA1, 0x0C]),
        (
            1,
            REG_WRITE,
            &[0x68, 0, 0xC8, 0, 0, 0],
            &[
                0x01, 0x09, 0x00, 0x04, 0x68, 0x00, 0xC8, 0x00, 0x00, 0x00, 0xAE, 0x8E,
            ],
        ),
        (1, ACTION, &[], &[0x01, 0x03, 0x00, 0x05, 0x02, 0xCE]),
        (
            1,
            FACTORY_RESET,
            &[1],
            &[0x01, 0x04, 0x00, 0x06, 0x01, 0xA1, 0xE6],
        ),
        (1, REBOOT, &[], &[0x01, 0x03, 0x00, 0x08, 0x2F, 0x4E]),
        (
            1,
            CLEAR,
            &CLEAR_TURNS,
            &[
                0x01, 0x08, 0x00, 0x10, 0x01, 0x44, 0x58, 0x4C, 0x22, 0xB1, 0xDC,
            ],
        ),
        (
            BROADCAST,
            SYNC_READ,
            &[0x84, 0, 4, 0, 1, 2],
            &[
                0xFE, 0x09, 0x00, 0x82, 0x84, 0x00, 0x04, 0x00, 0x01, 0x02, 0xCE, 0xFA,
            ],
        ),
        (
            2,
            STATUS,
            &[0, 0x1F, 8, 0, 0],
            &[
                0x02, 0x08, 0x00, 0x55, 0x00, 0x1F, 0x08, 0x00, 0x00, 0xBA, 0xBE,
            ],
        ),
        (
            BROADCAST,
            SYNC_WRITE,
            &[0x74, 0, 4, 0, 1, 0x96, 0, 0, 0, 2, 0xAA, 0, 0, 0],
            &[
                0xFE, 0x11, 0x00, 0x83, 0x74, 0x00, 0x04, 0x00, 0x01, 0x96, 0x00, 0x00, 0x00, 0x02,
                0xAA, 0x00, 0x00, 0x00, 0x82, 0x87,
            ],
        ),
        (
            BROADCAST,
            BULK_READ,
            &[1, 0x90, 0, 2, 0, 2, 0x92, 0, 1, 0],
            &[
                0xFE, 0x0D, 0x00, 0x92, 0x01, 0x90, 0x00, 0x02, 0x00, 0x02, 0x92, 0x00, 0x01, 0x00,
                0x1A, 0x05,
            ],
        ),
        (
            1,
            STATUS,
            &[0, 0x77, 0],
            &[0x01, 0x06, 0x00, 0x55, 0x00, 0x77, 0x00, 0xC3, 0x69],
        ),
        (
            2,
            STATUS,
            &[0, 0x24],
            &[0x02, 0x05, 0x00, 0x55, 0x00, 0x24, 0x8B, 0xA9],
        ),
        (
            BROADCAST,
            BULK_WRITE,
            &[1, 0x20, 0, 2, 0, 0xA0, 0, 2, 0x1F, 0, 1, 0, 0x50],
            &[
                0xFE, 0x10, 0x00, 0x93, 0x01, 0x20, 0x00, 0x02, 0x00, 0xA0, 0x00, 0x02, 0x1F, 0x00,
                0x01, 0x00, 0x50, 0xB7, 0x68,
            ],
        ),
    ];

    #[test]
    fn writes_the_manual_s_packets() {
        for (id, instruction, parameters, expected) in MANUAL {
            let mut buffer = [0; LONGEST];
            let sent = packet(&mut buffer, *id, *instruction, parameters).unwrap();
            assert_eq!(&sent[..4], HEADER);
            assert_eq!(
                &sent[4..],
                *expected,
                "{id} {instruction:02X} {parameters:02X?}"
            );
        }
    }

    #[test]
    fn stuffs_each_pattern_once() {
        let mut buffer = [0; 64];
        let cases: [(&[u8], &[u8]); 5] = [
            (&[0xFF, 0xFF, 0xFD], &[0xFF, 0xFF, 0xFD, 0xFD]),
            (&[0xFF, 0xFF, 0xFD, 0xFD], &[0xFF, 0xFF, 0xFD, 0xFD, 0xFD]),
            (
                &[0xFF, 0xFF, 0xFF, 0xFD, 0],
                &[0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0],
            ),
            (&[0xFF, 0xFD, 0xFF, 0xFF], &[0xFF, 0xFD, 0xFF, 0xFF]),
            (
                &[0xFF, 0xFF, 0xFD, 0xFF, 0xFF, 0xFD],
                &[0xFF, 0xFF, 0xFD, 0xFD, 0xFF, 0xFF, 0xFD, 0xFD],
            ),
        ];
        for (raw, stuffed) in cases {
            let sent = packet(&mut buffer, 1, WRITE, raw).unwrap();
            assert_eq!(&sent[HEAD + 1..sent.len() - 2], stuffed);
            assert_eq!(usize::from(sent[5]), stuffed.len() + 3);
        }
    }

    #[test]
    fn a_packet_that_does_not_fit_is_refused_completely() {
        let whole = packet(&mut [0; 64], 1, WRITE, &[0xFF, 0xFF, 0xFD, 7])
            .unwrap()
            .len();
        for size in 0..whole {
            let mut buffer = vec![0; size];
            let refused = packet(&mut buffer, 1, WRITE, &[0xFF, 0xFF, 0xFD, 7]);
            assert_eq!(refused, Err(Full(size)));
        }
        assert!(packet(&mut vec![0; whole], 1, WRITE, &[0xFF, 0xFF, 0xFD, 7]).is_ok());
        assert_eq!(
            packet(&mut [0; 2 * LONGEST], 1, WRITE, &[0; LONGEST - HEAD - 2]),
            Err(Full(LONGEST))
        );
        assert!(packet(&mut [0; 2 * LONGEST], 1, WRITE, &[0; LONGEST - HEAD - 3]).is_ok());
        assert!(Full(3).to_string().contains("3 bytes"));
    }
}
