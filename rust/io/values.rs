//! Columns of numbers of any type: what a file holds for each vertex besides positions.

use bytemuck::Pod;

/// Numbers of one type.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // the names say all
pub enum Values {
    Bool(Vec<bool>),
    I8(Vec<i8>),
    U8(Vec<u8>),
    I16(Vec<i16>),
    U16(Vec<u16>),
    I32(Vec<i32>),
    U32(Vec<u32>),
    I64(Vec<i64>),
    U64(Vec<u64>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Runs one expression for whatever type the numbers have.
macro_rules! with_values {
    ($values:expr, $vector:ident => $body:expr) => {
        $crate::io::values::with_values!(@ $values, $vector, $body; Bool I8 U8 I16 U16 I32 U32 I64 U64 F32 F64)
    };
    (@ $values:expr, $vector:ident, $body:expr; $($variant:ident)*) => {
        match $values {
            $($crate::io::Values::$variant($vector) => $body,)*
        }
    };
}
pub(super) use with_values;

/// The types a file can store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Scalar::F32 | Scalar::F64)
    }

    pub(super) fn empty(self) -> Values {
        macro_rules! arms {
            ($($variant:ident)*) => { match self { $(Scalar::$variant => Values::$variant(Vec::new()),)* } };
        }
        arms!(I8 U8 I16 U16 I32 U32 I64 U64 F32 F64)
    }
}

/// A number that a column can hold.
pub(super) trait Number: Copy {
    const NAME: &'static str;
    fn column(numbers: Vec<Self>) -> Values;
    fn as_double(self) -> f64;
    fn as_whole(self) -> Option<i128>;
}

macro_rules! numbers {
    ($($type:ty, $variant:ident, $name:literal, $value:ident => $double:expr, $whole:expr;)*) => {
        $(impl Number for $type {
            const NAME: &'static str = $name;
            fn column(numbers: Vec<Self>) -> Values {
                Values::$variant(numbers)
            }
            fn as_double(self) -> f64 {
                let $value = self;
                $double
            }
            fn as_whole(self) -> Option<i128> {
                let $value = self;
                $whole
            }
        })*
    };
}
numbers! {
    bool, Bool, "bool", value => f64::from(u8::from(value)), Some(value.into());
    i8, I8, "int8", value => value.into(), Some(value.into());
    u8, U8, "uint8", value => value.into(), Some(value.into());
    i16, I16, "int16", value => value.into(), Some(value.into());
    u16, U16, "uint16", value => value.into(), Some(value.into());
    i32, I32, "int32", value => value.into(), Some(value.into());
    u32, U32, "uint32", value => value.into(), Some(value.into());
    i64, I64, "int64", value => value as f64, Some(value.into());
    u64, U64, "uint64", value => value as f64, Some(value.into());
    f32, F32, "float32", value => value.into(), { let _ = value; None };
    f64, F64, "float64", value => value, { let _ = value; None };
}

/// A number that stands in a file in either byte order.
pub(super) trait Stored: Pod + Number {
    fn swapped(self) -> Self;
}

macro_rules! stored {
    ($($type:ty),*) => { $(impl Stored for $type { fn swapped(self) -> Self { Self::from_ne_bytes({ let mut bytes = self.to_ne_bytes(); bytes.reverse(); bytes }) } })* };
}
stored!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);

/// The number at an offset of a record; zero beyond its end.
#[inline]
pub(super) fn at<T: Stored>(record: &[u8], offset: usize, swap: bool) -> T {
    let number = record.get(offset..offset + size_of::<T>()).map_or(T::zeroed(), bytemuck::pod_read_unaligned);
    if swap { T::swapped(number) } else { number }
}

/// Calls for the number of a type at an offset of a record, as a value of its own type.
macro_rules! with_number {
    ($scalar:expr, $record:expr, $offset:expr, $swap:expr, $number:ident => $body:expr) => {
        $crate::io::values::with_number!(@ $scalar, $record, $offset, $swap, $number, $body;
            I8 i8 U8 u8 I16 i16 U16 u16 I32 i32 U32 u32 I64 i64 U64 u64 F32 f32 F64 f64)
    };
    (@ $scalar:expr, $record:expr, $offset:expr, $swap:expr, $number:ident, $body:expr; $($variant:ident $type:ident)*) => {
        match $scalar {
            $(Scalar::$variant => {
                let $number = $crate::io::values::at::<$type>($record, $offset, $swap);
                $body
            })*
        }
    };
}
pub(super) use with_number;

impl Values {
    /// How many numbers.
    pub fn len(&self) -> usize {
        with_values!(self, vector => vector.len())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Name of the type, as numpy calls it.
    pub fn type_name(&self) -> &'static str {
        fn name<T: Number>(_: &[T]) -> &'static str {
            T::NAME
        }
        with_values!(self, vector => name(vector))
    }

    /// One of the numbers as a double; nothing beyond the end.
    pub fn number(&self, index: usize) -> Option<f64> {
        with_values!(self, vector => vector.get(index).map(|value| value.as_double()))
    }

    /// One of the numbers, if it is whole and not a float.
    pub(super) fn whole(&self, index: usize) -> Option<i128> {
        with_values!(self, vector => vector.get(index).and_then(|value| value.as_whole()))
    }

    /// The rows of `columns` numbers that `rows` names.
    pub(super) fn rows(&self, rows: &[u32], columns: usize) -> Values {
        fn pick<T: Number>(vector: &[T], rows: &[u32], columns: usize) -> Values {
            T::column(rows.iter().flat_map(|&row| vector[row as usize * columns..][..columns].iter().copied()).collect())
        }
        with_values!(self, vector => pick(vector, rows, columns))
    }

    /// Columns of the same type side by side; nothing if their types or lengths differ.
    pub(super) fn side_by_side(columns: &[&Values]) -> Option<Values> {
        fn interleave<'a, T: Copy + 'a>(columns: &[&'a Values], inner: impl Fn(&'a Values) -> Option<&'a Vec<T>>) -> Option<Vec<T>> {
            let vectors: Vec<&Vec<T>> = columns.iter().map(|column| inner(column)).collect::<Option<_>>()?;
            let rows = vectors.first()?.len();
            if vectors.iter().any(|vector| vector.len() != rows) {
                return None;
            }
            Some((0..rows).flat_map(|row| vectors.iter().map(move |vector| vector[row])).collect())
        }
        macro_rules! arms {
            ($($variant:ident),*) => {
                match columns.first()? {
                    $(Values::$variant(_) => Values::$variant(interleave(columns, |column| match column { Values::$variant(vector) => Some(vector), _ => None })?),)*
                }
            };
        }
        Some(arms!(Bool, I8, U8, I16, U16, I32, U32, I64, U64, F32, F64))
    }

    /// The same numbers in the type that `name` names (see [`Values::type_name`]); nothing if one of them would change.
    pub(super) fn converted(&self, name: &str) -> Option<Values> {
        fn whole<T: TryFrom<i128>>(values: &Values) -> Option<Vec<T>> {
            (0..values.len())
                .map(|i| {
                    let number = match values {
                        Values::F32(_) | Values::F64(_) => {
                            let number = values.number(i)?;
                            (number == number.trunc() && number.abs() < 1e30).then_some(number as i128)?
                        }
                        _ => values.whole(i)?,
                    };
                    T::try_from(number).ok()
                })
                .collect()
        }
        if name == self.type_name() {
            return Some(self.clone());
        }
        Some(match name {
            "bool" => Values::Bool(whole::<u8>(self)?.into_iter().map(|value| (value <= 1).then_some(value == 1)).collect::<Option<_>>()?),
            "int8" => Values::I8(whole(self)?),
            "uint8" => Values::U8(whole(self)?),
            "int16" => Values::I16(whole(self)?),
            "uint16" => Values::U16(whole(self)?),
            "int32" => Values::I32(whole(self)?),
            "uint32" => Values::U32(whole(self)?),
            "int64" => Values::I64(whole(self)?),
            "uint64" => Values::U64(whole(self)?),
            "float32" => Values::F32(
                (0..self.len())
                    .map(|i| {
                        self.number(i).and_then(|number| (f64::from(number as f32) == number || number.is_nan()).then_some(number as f32))
                    })
                    .collect::<Option<_>>()?,
            ),
            "float64" => Values::F64((0..self.len()).map(|i| self.number(i)).collect::<Option<_>>()?),
            _ => return None,
        })
    }
}

/// Numbers of each vertex under a name: colours, normals, labels, whatever a file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// What the numbers are called.
    pub name: String,
    /// How many numbers a vertex has.
    pub columns: usize,
    /// Whether this is a table: one of a single column differs from a vector.
    pub table: bool,
    /// The numbers, vertex after vertex.
    pub values: Values,
}

impl Field {
    pub(super) fn vector(name: impl Into<String>, values: Values) -> Self {
        Field { name: name.into(), columns: 1, table: false, values }
    }

    pub(super) fn table(name: impl Into<String>, columns: usize, values: Values) -> Self {
        Field { name: name.into(), columns, table: true, values }
    }
}
