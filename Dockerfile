# Penumbra with lavapipe, Mesa's Vulkan on the CPU:
#   docker build -t penumbra .
#   docker run --rm -v "$PWD:/work" penumbra render scenes/box.glb -o box.png
FROM debian:bookworm-slim AS build
COPY . /penumbra
RUN /penumbra/scripts/with-vulkan /penumbra/scripts/make-release

FROM debian:bookworm-slim
RUN apt-get update -q \
    && apt-get install -qy --no-install-recommends libvulkan1 mesa-vulkan-drivers \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /penumbra/target/release/penumbra /usr/local/bin/penumbra
# Mesa wants a folder for its sockets.
ENV XDG_RUNTIME_DIR=/tmp
WORKDIR /work
ENTRYPOINT ["penumbra"]
