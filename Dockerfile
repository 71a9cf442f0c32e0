# The program with all features that need no toolkit.
#
#   docker build -t sms . && docker run --rm -v "$PWD:/data" sms demo billiards --quick
FROM rust:1.95-slim-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends build-essential && rm -rf /var/lib/apt/lists/*
WORKDIR /sms
COPY . .
RUN cargo build --profile dist --locked -p sms-cli --features gpu,nets,mujoco

FROM debian:bookworm-slim
# Vulkan for scans on a GPU, and certificates for the weights of networks and for language models.
RUN apt-get update && apt-get install -y --no-install-recommends libvulkan1 ca-certificates && rm -rf /var/lib/apt/lists/*
COPY --from=build /sms/target/dist/sms /usr/local/bin/sms
WORKDIR /data
ENTRYPOINT ["sms"]
