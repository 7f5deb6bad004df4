//! The one scanner of all text formats: words of a line, lines of a file, numbers read exactly.

use super::source::{Parsed, Stop};
use crate::control::Control;
use std::borrow::Cow;

const WORD: u8 = 0;
const BLANK: u8 = 1;
const NEWLINE: u8 = 2;
const COMMENT: u8 = 3;
const CONTINUATION: u8 = 4;

/// What each byte means to a format.
pub(super) type Classes = [u8; 256];

const fn classes(comment: bool, continuation: bool, separators: &[u8]) -> Classes {
    let mut table = [WORD; 256];
    table[b' ' as usize] = BLANK;
    table[b'\t' as usize] = BLANK;
    table[0x0b] = BLANK;
    table[0x0c] = BLANK;
    table[b'\n' as usize] = NEWLINE;
    table[b'\r' as usize] = NEWLINE;
    if comment {
        table[b'#' as usize] = COMMENT;
    }
    if continuation {
        table[b'\\' as usize] = CONTINUATION;
    }
    let mut i = 0;
    while i < separators.len() {
        table[separators[i] as usize] = BLANK;
        i += 1;
    }
    table
}

/// Words between blanks.
pub(super) static PLAIN: Classes = classes(false, false, b"");
/// The same with `#` comments.
pub(super) static COMMENTED: Classes = classes(true, false, b"");
/// The same with lines that go on after a backslash.
pub(super) static CONTINUED: Classes = classes(true, true, b"");
/// Words between blanks, commas or semicolons.
pub(super) static SEPARATED: Classes = classes(true, false, b",;");

const LINES_BETWEEN_REPORTS: usize = 4096;

/// Text that is read word by word; it knows its line.
pub(super) struct Text<'a> {
    bytes: &'a [u8],
    at: usize,
    line: usize,
    classes: &'static Classes,
    control: &'a Control,
    reported: usize,
}

impl<'a> Text<'a> {
    pub(super) fn new(bytes: &'a [u8], line: usize, classes: &'static Classes, control: &'a Control) -> Self {
        Text { bytes, at: 0, line, classes, control, reported: line }
    }

    /// Number of the line, from 1.
    pub(super) fn line(&self) -> usize {
        self.line
    }

    pub(super) fn length(&self) -> usize {
        self.bytes.len()
    }

    fn class(&self) -> Option<u8> {
        self.bytes.get(self.at).map(|&byte| self.classes[byte as usize])
    }

    fn pass_newline(&mut self) {
        let carriage = self.bytes[self.at] == b'\r';
        self.at += 1;
        if carriage && self.bytes.get(self.at) == Some(&b'\n') {
            self.at += 1;
        }
        self.line += 1;
    }

    /// Whether a newline follows the backslash here.
    fn continues(&self) -> bool {
        matches!(self.bytes.get(self.at + 1), Some(b'\n' | b'\r'))
    }

    /// The next word of this line.
    #[inline]
    pub(super) fn word(&mut self) -> Option<&'a [u8]> {
        loop {
            match self.class()? {
                BLANK => self.at += 1,
                NEWLINE => return None,
                COMMENT => {
                    self.pass_comment();
                    return None;
                }
                CONTINUATION if self.continues() => {
                    self.at += 1;
                    self.pass_newline();
                }
                _ => break,
            }
        }
        let start = self.at;
        while let Some(class) = self.class() {
            if class == WORD || (class == CONTINUATION && !self.continues()) {
                self.at += 1;
            } else {
                break;
            }
        }
        Some(&self.bytes[start..self.at])
    }

    fn pass_comment(&mut self) {
        while self.class().is_some_and(|class| class != NEWLINE) {
            self.at += 1;
        }
    }

    /// Goes to the end of this line.
    pub(super) fn pass_line(&mut self) {
        while let Some(class) = self.class() {
            match class {
                NEWLINE => return,
                CONTINUATION if self.continues() => {
                    self.at += 1;
                    self.pass_newline();
                }
                _ => self.at += 1,
            }
        }
    }

    /// Goes to the next line that holds a word, from anywhere in the last one; false at the end of the text.
    pub(super) fn next_line(&mut self) -> Parsed<bool> {
        self.pass_line();
        self.more()
    }

    /// Goes to the next word of the text, in this line or a later one; false at the end of the text.
    pub(super) fn more(&mut self) -> Parsed<bool> {
        if self.line >= self.reported + LINES_BETWEEN_REPORTS {
            self.reported = self.line;
            self.control.report(self.at as f64 / self.bytes.len().max(1) as f64)?;
        }
        while let Some(class) = self.class() {
            match class {
                BLANK => self.at += 1,
                NEWLINE => self.pass_newline(),
                COMMENT => self.pass_comment(),
                CONTINUATION if self.continues() => {
                    self.at += 1;
                    self.pass_newline();
                }
                _ => return Ok(true),
            }
        }
        Ok(false)
    }

    /// The next number of this line, or an error that says what it should have been.
    #[inline]
    pub(super) fn number(&mut self, what: &str) -> Parsed<f64> {
        match self.word() {
            Some(word) => match number(word) {
                Some(number) => Ok(number),
                None => Stop::line(self.line, format!("{what}: {:?} is no number", shown(word))),
            },
            None => Stop::line(self.line, format!("{what} is missing")),
        }
    }

    /// The next number of this line, which must be finite.
    #[inline]
    pub(super) fn coordinate(&mut self) -> Parsed<f64> {
        let number = self.number("coordinate")?;
        if number.is_finite() { Ok(number) } else { Stop::line(self.line, format!("a coordinate is {number}; positions must be finite")) }
    }

    /// The next whole number of this line.
    pub(super) fn whole(&mut self, what: &str) -> Parsed<i64> {
        match self.word() {
            Some(word) => match whole(word) {
                Some(number) => Ok(number),
                None => Stop::line(self.line, format!("{what}: {:?} is no whole number", shown(word))),
            },
            None => Stop::line(self.line, format!("{what} is missing")),
        }
    }

    /// The next whole number of this line, as a count.
    pub(super) fn count(&mut self, what: &str) -> Parsed<usize> {
        let number = self.whole(what)?;
        usize::try_from(number).or_else(|_| Stop::line(self.line, format!("{what} is {number}; it cannot be negative")))
    }
}

/// A word as it may stand in a message.
pub(super) fn shown(word: &[u8]) -> String {
    let mut text = String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned();
    if word.len() > 40 {
        text.push_str("...");
    }
    text
}

const POWERS: [f64; 23] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22];

/// The double nearest to a decimal number; nothing if the word is none.
#[inline]
pub(super) fn number(word: &[u8]) -> Option<f64> {
    exact(word).or_else(|| std::str::from_utf8(word).ok()?.parse().ok())
}

/// Up to 15 digits times a power of ten that a double holds exactly: one correctly rounded operation gives the answer.
#[inline]
fn exact(word: &[u8]) -> Option<f64> {
    let (negative, digits) = match word.first()? {
        b'-' => (true, &word[1..]),
        b'+' => (false, &word[1..]),
        _ => (false, word),
    };
    let (mut mantissa, mut count, mut point) = (0u64, 0usize, None);
    let mut at = 0;
    while let Some(&byte) = digits.get(at) {
        let digit = byte.wrapping_sub(b'0');
        if digit < 10 {
            if count >= 18 {
                return None;
            }
            mantissa = mantissa * 10 + u64::from(digit);
            count += 1;
        } else if byte == b'.' && point.is_none() {
            point = Some(at);
        } else {
            break;
        }
        at += 1;
    }
    if count == 0 || mantissa > 1 << 53 {
        return None;
    }
    let mut power = point.map_or(0, |point| point as i32 + 1 - at as i32);
    if at < digits.len() {
        if !matches!(digits[at], b'e' | b'E') {
            return None;
        }
        power += small(&digits[at + 1..])?;
    }
    let value = mantissa as f64;
    let value = match power {
        -22..0 => value / POWERS[-power as usize],
        0..=22 => value * POWERS[power as usize],
        _ => return None,
    };
    Some(if negative { -value } else { value })
}

/// A signed number of one to three digits.
fn small(word: &[u8]) -> Option<i32> {
    let (negative, digits) = match word.first()? {
        b'-' => (true, &word[1..]),
        b'+' => (false, &word[1..]),
        _ => (false, word),
    };
    if digits.is_empty() || digits.len() > 3 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let value = digits.iter().fold(0, |value, &digit| value * 10 + i32::from(digit - b'0'));
    Some(if negative { -value } else { value })
}

/// A whole number; nothing if the word is none or needs more than 63 bits.
#[inline]
pub(super) fn whole(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word.first()? {
        b'-' => (true, &word[1..]),
        b'+' => (false, &word[1..]),
        _ => (false, word),
    };
    if digits.is_empty() || digits.len() > 19 {
        return None;
    }
    let mut value = 0i64;
    for &byte in digits {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            return None;
        }
        value = value.checked_mul(10)?.checked_sub(i64::from(digit))?;
    }
    if negative { Some(value) } else { value.checked_neg() }
}

/// The text as UTF-8: byte order marks are honoured, UTF-16 is converted.
pub(super) fn decoded(bytes: &[u8]) -> Cow<'_, [u8]> {
    let wide = |big: bool| {
        let units = bytes[2..]
            .chunks_exact(2)
            .map(|pair| if big { u16::from_be_bytes([pair[0], pair[1]]) } else { u16::from_le_bytes([pair[0], pair[1]]) });
        Cow::Owned(char::decode_utf16(units).map(|unit| unit.unwrap_or(char::REPLACEMENT_CHARACTER)).collect::<String>().into_bytes())
    };
    match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => Cow::Borrowed(rest),
        [0xfe, 0xff, ..] => wide(true),
        [0xff, 0xfe, ..] => wide(false),
        _ => Cow::Borrowed(bytes),
    }
}

/// Appends the shortest text that reads back as the same number.
pub(super) fn push_number(out: &mut Vec<u8>, number: f64) {
    use std::io::Write;
    if number == number.trunc() && number.abs() < 1e15 && !(number == 0.0 && number.is_sign_negative()) {
        let _ = write!(out, "{}", number as i64); // writing to a vector cannot fail
    } else {
        let _ = write!(out, "{number:?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_are_read_as_the_standard_library_reads_them(number_ in prop::num::f64::ANY, digits in 0usize..20, mantissa: i64, power in -30i32..30) {
            for text in [format!("{number_:?}"), format!("{number_}"), format!("{number_:.digits$e}"), format!("{mantissa}e{power}"), format!("{:.6}", mantissa as f64 / 1e15)] {
                let expected: f64 = text.parse().unwrap();
                let got = number(text.as_bytes()).unwrap();
                prop_assert!(got.to_bits() == expected.to_bits() || (got.is_nan() && expected.is_nan()), "{text}: {got:?} for {expected:?}");
            }
        }

        #[test]
        fn no_word_is_a_number_here_that_is_none_elsewhere(word in "[-+0-9.eE]{0,12}") {
            prop_assert_eq!(number(word.as_bytes()), word.parse::<f64>().ok());
        }

        #[test]
        fn written_numbers_read_back(value in prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO) {
            let mut out = Vec::new();
            push_number(&mut out, value);
            prop_assert_eq!(number(&out).unwrap().to_bits(), value.to_bits());
        }
    }

    #[test]
    fn whole_numbers() {
        for (text, expected) in [
            ("0", Some(0)),
            ("-0", Some(0)),
            ("+7", Some(7)),
            ("9223372036854775807", Some(i64::MAX)),
            ("-9223372036854775808", Some(i64::MIN)),
            ("9223372036854775808", None),
            ("", None),
            ("-", None),
            ("1.0", None),
        ] {
            assert_eq!(whole(text.as_bytes()), expected, "{text}");
        }
    }

    #[test]
    fn lines_and_words() {
        let control = Control::default();
        let mut text = Text::new(b"a b\\\n c # d\r\n\r\n\re\\f", 1, &CONTINUED, &control);
        assert!(text.more().unwrap());
        assert_eq!((text.word(), text.word(), text.word(), text.word()), (Some(&b"a"[..]), Some(&b"b"[..]), Some(&b"c"[..]), None));
        assert!(text.next_line().unwrap());
        assert_eq!((text.line(), text.word()), (5, Some(&b"e\\f"[..])));
        assert!(!text.next_line().unwrap());
    }
}
