//! The checksum of Dynamixel Protocol 2.0: CRC-16 with the polynomial 0x8005, most significant bit
//! first, from 0.
//!
//! Source: ROBOTIS, "CRC Calculation" of the Protocol 2.0 manual; pinned by the manual's own
//! packets (`packet.rs`).

const POLYNOMIAL: u16 = 0x8005;

const TABLE: [u16; 256] = {
    let mut table = [0u16; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut value = (byte as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            value = (value << 1) ^ if value & 0x8000 != 0 { POLYNOMIAL } else { 0 };
            bit += 1;
        }
        table[byte] = value;
        byte += 1;
    }
    table
};

/// The checksum of `bytes` after bytes with the checksum `before`, 0 at the start of a packet.
pub fn crc(before: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(before, |value, byte| {
        (value << 8) ^ TABLE[usize::from((value >> 8) as u8 ^ byte)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goes_on_where_it_was_left() {
        let bytes: Vec<u8> = (0..=255).collect();
        for cut in 0..bytes.len() {
            assert_eq!(crc(crc(0, &bytes[..cut]), &bytes[cut..]), crc(0, &bytes));
        }
    }

    #[test]
    fn equals_division_bit_by_bit() {
        let mut slow = 0u16;
        for byte in 0..=255u8 {
            for bit in (0..8).rev() {
                let out = (slow >> 15) ^ u16::from(byte >> bit & 1);
                slow = (slow << 1) ^ if out == 1 { POLYNOMIAL } else { 0 };
            }
        }
        assert_eq!(crc(0, &(0..=255).collect::<Vec<u8>>()), slow);
    }
}
