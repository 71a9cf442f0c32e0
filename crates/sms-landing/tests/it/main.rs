//! Integration tests of sms-landing.

mod example;
mod landing;
