# UniCon in a container: on Debian slim with the ROS wheels, or on an image of ROS.
#
#   docker build -t unicon .
#   docker build -t unicon:jazzy --build-arg BASE=ros:jazzy-ros-base --build-arg EXTRAS=sim,bags,view .
#   docker run --rm --network host unicon run go2_walk --duration 10
ARG BASE=debian:trixie-slim
FROM ${BASE}
ARG EXTRAS=sim,bags,ros,view
RUN apt-get update \
 && apt-get install -y --no-install-recommends python3 python3-venv ca-certificates \
 && rm -rf /var/lib/apt/lists/*
COPY . /src
# With the system's packages, so that an image of ROS gives its own rclpy and NumPy.
RUN python3 -m venv --system-site-packages /opt/unicon \
 && /opt/unicon/bin/pip install --no-cache-dir "/src[${EXTRAS}]" \
 && rm -rf /src
ENV PATH=/opt/unicon/bin:${PATH}
ENTRYPOINT ["unicon"]
CMD ["--help"]
