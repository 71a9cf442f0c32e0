//! The front end of the command `sms`, for other programs on the same pipeline.

pub mod front;
