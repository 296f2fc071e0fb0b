//! Find packets of Dynamixel Protocol 2.0 in a stream of arbitrary bytes.
//!
//! A header is accepted only if its packet is complete and the checksum agrees. Otherwise the
//! search continues one byte after it, so junk never hides later packets. Because of byte stuffing,
//! no packet contains a header; a packet with another header in it was truncated and is dropped
//! immediately. A length above the expected one is not a packet. Nothing is allocated. Pinned by
//! the tests below: any bytes, cut anywhere.

use crate::crc::crc;
use crate::packet::{BROADCAST, HEAD, HEADER, LONGEST, instruction::STATUS};

/// Bytes of the shortest packet: head, instruction, checksum.
const SHORTEST: usize = HEAD + 3;
/// Most stored bytes: the longest packet, plus the rest of a read.
const ROOM: usize = 2 * LONGEST;

/// A received packet, with its parameters without stuffing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received<'a> {
    pub id: u8,
    pub instruction: u8,
    pub parameters: &'a [u8],
}

impl<'a> Received<'a> {
    /// As an answer: its error byte and data.
    pub fn status(&self) -> Option<(u8, &'a [u8])> {
        match self.parameters.split_first() {
            Some((error, data)) if self.instruction == STATUS => Some((*error, data)),
            _ => None,
        }
    }
}

/// Received bytes, and the read position.
#[derive(Debug, Clone)]
pub struct Decoder {
    bytes: [u8; ROOM],
    start: usize,
    end: usize,
    plain: [u8; LONGEST],
    /// Bytes outside packets.
    pub skipped: u64,
    /// Packets with a wrong checksum, or truncated ones.
    pub damaged: u64,
}

impl Default for Decoder {
    fn default() -> Decoder {
        Decoder {
            bytes: [0; ROOM],
            start: 0,
            end: 0,
            plain: [0; LONGEST],
            skipped: 0,
            damaged: 0,
        }
    }
}

/// The beginning of the received bytes.
enum Found {
    /// A packet of this many bytes.
    Packet(usize),
    /// More bytes are needed.
    Open,
    /// This many bytes are junk.
    Junk(usize),
}

impl Decoder {
    /// Add received bytes; the oldest are dropped if there is no space.
    pub fn push(&mut self, bytes: &[u8]) {
        let bytes = &bytes[bytes.len().saturating_sub(ROOM)..];
        let kept = (self.end - self.start).min(ROOM - bytes.len());
        self.skipped += (self.end - self.start - kept) as u64;
        self.bytes.copy_within(self.end - kept..self.end, 0);
        self.bytes[kept..kept + bytes.len()].copy_from_slice(bytes);
        (self.start, self.end) = (0, kept + bytes.len());
    }

    /// Discard all received bytes.
    pub fn clear(&mut self) {
        (self.start, self.end) = (0, 0);
    }

    /// Received bytes that are not read yet.
    pub fn waiting(&self) -> &[u8] {
        &self.bytes[self.start..self.end]
    }

    /// The next packet of at most `longest` bytes, if one is complete.
    pub fn next(&mut self, longest: usize) -> Option<Received<'_>> {
        let size = loop {
            match self.look(longest.min(LONGEST)) {
                Found::Packet(size) => break size,
                Found::Open => return None,
                Found::Junk(count) => {
                    self.start += count;
                    self.skipped += count as u64;
                }
            }
        };
        let at = self.start;
        self.start += size;
        let count = unstuff(&self.bytes[at + HEAD + 1..at + size - 2], &mut self.plain);
        Some(Received {
            id: self.bytes[at + 4],
            instruction: self.bytes[at + HEAD],
            parameters: &self.plain[..count],
        })
    }

    fn look(&mut self, longest: usize) -> Found {
        let waiting = &self.bytes[self.start..self.end];
        let begin = header(waiting);
        if begin > 0 {
            return Found::Junk(begin);
        }
        if waiting.len() < HEAD {
            return Found::Open;
        }
        let size = HEAD + usize::from(u16::from_le_bytes([waiting[5], waiting[6]]));
        if !(SHORTEST..=longest).contains(&size) || waiting[4] > BROADCAST {
            self.damaged += 1;
            return Found::Junk(1);
        }
        if waiting.len() >= size && sound(&waiting[..size]) {
            return Found::Packet(size);
        }
        let cut = HEADER.len() + header(&waiting[HEADER.len()..]);
        let another = waiting.len() >= cut + HEADER.len();
        if waiting.len() >= size || another {
            self.damaged += 1;
            return Found::Junk(1);
        }
        Found::Open
    }
}

/// Start of the first complete or possible header; `bytes.len()` if there is none.
fn header(bytes: &[u8]) -> usize {
    let begins = |at: &usize| {
        let some = (bytes.len() - at).min(HEADER.len());
        bytes[*at..at + some] == HEADER[..some]
    };
    (0..bytes.len()).find(begins).unwrap_or(bytes.len())
}

/// Whether the last two bytes are the checksum of the others.
fn sound(packet: &[u8]) -> bool {
    let (body, sum) = packet.split_at(packet.len() - 2);
    crc(0, body).to_le_bytes() == sum
}

/// Write `bytes` without stuffing to `out`, return how many they are.
fn unstuff(bytes: &[u8], out: &mut [u8]) -> usize {
    let mut count = 0;
    let mut stuffed = false;
    for byte in bytes {
        if stuffed && *byte == 0xFD {
            stuffed = false;
            continue;
        }
        out[count] = *byte;
        count += 1;
        stuffed = count >= 3 && out[count - 3..count] == [0xFF, 0xFF, 0xFD];
    }
    count
}

/// The results of a fast sync read for each servo, with its index in `ids`: error byte and `size`
/// bytes of data.
///
///   FF FF FD 00 · FE · length · 55 · (error · id · data · CRC) · (error · id · data · CRC) …
///
/// Each checksum covers all bytes before it, so servos before a silent one are still read. Slots
/// are fixed, without stuffing. A slot with a wrong checksum or id ends the reading, because the
/// rest has no valid checksum.
pub fn fast_slots<'a>(
    bytes: &'a [u8],
    ids: &'a [u8],
    size: usize,
) -> impl Iterator<Item = (usize, u8, &'a [u8])> {
    let slot = size + 4;
    let length = ids.len() * slot + 1;
    let begin = (0..bytes.len()).find(|at| {
        let Some(some) = bytes.get(*at..at + HEAD + 1) else {
            return false;
        };
        some[..4] == HEADER
            && some[4] == BROADCAST
            && usize::from(u16::from_le_bytes([some[5], some[6]])) == length
            && some[HEAD] == STATUS
    });
    let slots = begin.map(|at| (&bytes[at..at + HEAD + 1], &bytes[at + HEAD + 1..]));
    let (first, rest) = slots.unwrap_or((&[], &[]));
    let mut sum = crc(0, first);
    rest.chunks_exact(slot)
        .zip(ids)
        .enumerate()
        .map_while(move |(place, (slot, id))| {
            let (body, check) = slot.split_at(slot.len() - 2);
            sum = crc(sum, body);
            let sound = body[1] == *id && sum.to_le_bytes() == check;
            sum = crc(sum, check);
            sound.then_some((place, body[0], &body[2..]))
        })
}

#[cfg(test)]
#[path = "decoder_tests.rs"]
mod tests;
