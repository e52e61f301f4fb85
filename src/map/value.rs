//! How numbers lie in registers: the formats of rows, and the types that behaviour reads and writes.

/// How the words of a row make up its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One bit of a coil or discrete input.
    Bit,
    /// One unsigned word.
    U16,
    /// One word in two's complement.
    S16,
    /// Two words, high word first.
    U32,
    /// Two words in two's complement, high word first.
    S32,
    /// Two signed words: the whole part, then the decimals, of as many digits as the row's `scale` says.
    WholeAndDecimals,
    /// The same of a number that is never negative, in unsigned words.
    UnsignedWholeAndDecimals,
    /// Two words: ten thousands, then the rest below ten thousand.
    TenThousands,
}

impl Format {
    /// The name that exports print.
    pub const fn name(self) -> &'static str {
        match self {
            Format::Bit => "bit",
            Format::U16 => "u16",
            Format::S16 => "s16",
            Format::U32 => "u32",
            Format::S32 => "s32",
            Format::WholeAndDecimals => "whole+decimals",
            Format::UnsignedWholeAndDecimals => "unsigned whole+decimals",
            Format::TenThousands => "10000s+rest",
        }
    }

    /// Words that a value of this format takes.
    pub const fn words(self) -> u16 {
        match self {
            Format::Bit | Format::U16 | Format::S16 => 1,
            _ => 2,
        }
    }

    /// The raw number that `words` stand for. `scale` is the count of decimal digits of [`Format::WholeAndDecimals`]
    /// and its unsigned sister, whose raw number counts the last of them. Words that are missing count as 0.
    pub fn decode(self, words: &[u16], scale: u8) -> i64 {
        let word = |index: usize| words.get(index).copied().unwrap_or(0);
        match self {
            Format::Bit | Format::U16 => i64::from(word(0)),
            Format::S16 => i64::from(word(0) as i16),
            Format::U32 => i64::from(u32::from(word(0)) << 16 | u32::from(word(1))),
            Format::S32 => i64::from((u32::from(word(0)) << 16 | u32::from(word(1))) as i32),
            Format::WholeAndDecimals => {
                i64::from(word(0) as i16) * 10_i64.pow(u32::from(scale)) + i64::from(word(1) as i16)
            }
            Format::UnsignedWholeAndDecimals => i64::from(word(0)) * 10_i64.pow(u32::from(scale)) + i64::from(word(1)),
            Format::TenThousands => i64::from(word(0)) * 10_000 + i64::from(word(1)),
        }
    }

    /// The words of a raw number, or `None` where it does not fit.
    pub fn encode(self, raw: i64, scale: u8) -> Option<[u16; 2]> {
        match self {
            Format::Bit => (0..=1).contains(&raw).then_some([raw as u16, 0]),
            Format::U16 => u16::try_from(raw).ok().map(|word| [word, 0]),
            Format::S16 => i16::try_from(raw).ok().map(|word| [word as u16, 0]),
            Format::U32 => u32::try_from(raw).ok().map(|n| [(n >> 16) as u16, n as u16]),
            Format::S32 => i32::try_from(raw).ok().map(|n| [(n >> 16) as u16, n as u16]),
            Format::WholeAndDecimals => {
                let unit = 10_i64.pow(u32::from(scale));
                let whole = i16::try_from(raw / unit).ok()?;
                Some([whole as u16, (raw % unit) as i16 as u16])
            }
            Format::UnsignedWholeAndDecimals | Format::TenThousands => {
                let unit = if self == Format::TenThousands { 10_000 } else { 10_i64.pow(u32::from(scale)) };
                let whole = u16::try_from(raw / unit).ok()?;
                (raw >= 0).then_some([whole, (raw % unit) as u16])
            }
        }
    }
}

/// A value that registers hold.
pub trait Value: Copy {
    /// How it is laid out.
    const FORMAT: Format;
    /// Reads it from exactly as many words as its format takes.
    fn from_words(words: &[u16]) -> Self;
    /// Writes it to exactly as many words as its format takes.
    fn to_words(self, words: &mut [u16]);
}

macro_rules! one_word {
    ($type:ty, $format:ident, $from:expr, $to:expr) => {
        impl Value for $type {
            const FORMAT: Format = Format::$format;
            fn from_words(words: &[u16]) -> Self {
                $from(words[0])
            }
            fn to_words(self, words: &mut [u16]) {
                words[0] = $to(self);
            }
        }
    };
}
one_word!(bool, Bit, |word| word != 0, u16::from);
one_word!(u16, U16, |word| word, |value| value);
one_word!(i16, S16, |word| word as i16, |value| value as u16);

impl Value for u32 {
    const FORMAT: Format = Format::U32;
    fn from_words(words: &[u16]) -> Self {
        u32::from(words[0]) << 16 | u32::from(words[1])
    }
    fn to_words(self, words: &mut [u16]) {
        words[0] = (self >> 16) as u16;
        words[1] = self as u16;
    }
}

impl Value for i32 {
    const FORMAT: Format = Format::S32;
    fn from_words(words: &[u16]) -> Self {
        u32::from_words(words) as i32
    }
    fn to_words(self, words: &mut [u16]) {
        (self as u32).to_words(words);
    }
}

/// A number split into its whole part and its decimals, both with the sign (PFC-4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WholeAndDecimals {
    /// The whole part.
    pub whole: i16,
    /// The decimals, counted in the last digit.
    pub decimals: i16,
}

impl Value for WholeAndDecimals {
    const FORMAT: Format = Format::WholeAndDecimals;
    fn from_words(words: &[u16]) -> Self {
        Self { whole: words[0] as i16, decimals: words[1] as i16 }
    }
    fn to_words(self, words: &mut [u16]) {
        words[0] = self.whole as u16;
        words[1] = self.decimals as u16;
    }
}

/// A number that is never negative, split into its whole part and its decimals (PFC-1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnsignedWholeAndDecimals {
    /// The whole part.
    pub whole: u16,
    /// The decimals, counted in the last digit.
    pub decimals: u16,
}

impl Value for UnsignedWholeAndDecimals {
    const FORMAT: Format = Format::UnsignedWholeAndDecimals;
    fn from_words(words: &[u16]) -> Self {
        Self { whole: words[0], decimals: words[1] }
    }
    fn to_words(self, words: &mut [u16]) {
        words[0] = self.whole;
        words[1] = self.decimals;
    }
}

/// A count split at ten thousand: 121254 is 12 and 1254 (PFC-14).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct TenThousands(pub u32);

impl Value for TenThousands {
    const FORMAT: Format = Format::TenThousands;
    fn from_words(words: &[u16]) -> Self {
        Self(u32::from(words[0]) * 10_000 + u32::from(words[1]))
    }
    fn to_words(self, words: &mut [u16]) {
        words[0] = (self.0 / 10_000).min(u32::from(u16::MAX)) as u16;
        words[1] = (self.0 % 10_000) as u16;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn pfc_4_a_signed_pair_carries_the_sign_in_both_words() {
        assert_eq!(Format::WholeAndDecimals.encode(-1_250, 3), Some([0xFFFF, (-250_i16) as u16]));
        assert_eq!(Format::WholeAndDecimals.decode(&[0xFFFF, (-250_i16) as u16], 3), -1_250);
        assert_eq!(Format::WholeAndDecimals.encode(-950, 3), Some([0, (-950_i16) as u16]));
        assert_eq!(Format::WholeAndDecimals.encode(40_000_000, 3), None);
    }

    #[test]
    fn pfc_1_a_pair_that_is_never_negative_uses_all_sixteen_bits() {
        let format = Format::UnsignedWholeAndDecimals;
        assert_eq!(format.encode(4_320_025, 2), Some([43_200, 25]));
        assert_eq!(format.decode(&[43_200, 25], 2), 4_320_025);
        assert_eq!(format.encode(6_553_600, 2), None);
        assert_eq!(format.encode(-1, 2), None);
    }

    #[test]
    fn pfc_14_a_count_splits_at_ten_thousand() {
        assert_eq!(Format::TenThousands.encode(121_254, 0), Some([12, 1254]));
        assert_eq!(Format::TenThousands.decode(&[12, 1254], 0), 121_254);
        assert_eq!(Format::TenThousands.encode(9_999, 0), Some([0, 9_999]));
        assert_eq!(Format::TenThousands.encode(-1, 0), None);
    }
}
