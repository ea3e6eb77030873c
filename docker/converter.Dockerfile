# syntax=docker/dockerfile:1
# The commands that read and write volume files (convert, verify, export, info, synth), without the network.
#   docker build -f docker/converter.Dockerfile -t brickyard-converter .
#   docker run --rm -u "$(id -u):$(id -g)" -v "$PWD/cache:/source:ro" -v /srv/brickyard:/data brickyard-converter \
#       convert '/source/plume.*.vdb' /data/plume.bricks
FROM debian:12-slim AS build
WORKDIR /source
COPY tools/install-packages tools/
RUN tools/install-packages build
COPY . .
RUN --mount=type=cache,target=/root/.cache/ccache \
    tools/build converter brickyard \
    && strip -o /brickyard build/converter/brickyard

FROM debian:12-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libblosc1 libfmt9 libimath-3-1-29 libopenvdb10.0 libpng16-16 libprotobuf32 libstdc++6 libtbb12 libxxhash0 \
        libzstd1 zlib1g \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /brickyard /usr/local/bin/brickyard
COPY LICENSE /usr/share/doc/brickyard/LICENSE
# A library that the list above lacks ends the build here, not the first run.
RUN brickyard convert --help >/dev/null

USER 10001:10001
# Compressed raw dumps are unpacked in TMPDIR: give it room where they are large.
ENV TMPDIR=/tmp
VOLUME /data
WORKDIR /data
# convert finishes the frame that it writes; Ctrl-C and `docker stop` keep those that are done.
STOPSIGNAL SIGTERM
ENTRYPOINT ["brickyard"]
CMD ["--help"]
